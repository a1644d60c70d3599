import { expect, test } from "vitest";
import { reachOf, regionPoints } from "./scene-region";

const upright = { kind: "upright", height_m: 0.2, angle_rad: Math.PI / 2 } as const;

test("the points lie in the slice, within the reach, and none twice", () => {
  const points = regionPoints(upright, 0.5);
  expect(points.length).toBeGreaterThan(700);
  expect(points.length).toBeLessThan(1024);
  expect(points.every(({ point_m: [x, y, z] }) => Math.abs(x) < 1e-9 && Math.hypot(y, z) <= 0.5)).toBe(true);
  expect(new Set(points.map(({ point_m }) => point_m.map((value) => value.toFixed(6)).join())).size).toBe(points.length);
  expect(regionPoints({ ...upright, kind: "level" }, 0.5).every(({ point_m }) => point_m[2] === 0.2)).toBe(true);
});

test("the first points are spread over the whole slice", () => {
  const first = regionPoints(upright, 0.5).slice(0, 40);
  expect(Math.max(...first.map(({ point_m }) => point_m[1]))).toBeGreaterThan(0.3);
  expect(Math.min(...first.map(({ point_m }) => point_m[1]))).toBeLessThan(-0.3);
});

test.each([
  [{ reachable: true, free: true, position_error_m: 0.001 }, false, "free"],
  [{ reachable: true, free: false, position_error_m: 0 }, false, "contact"],
  [{ reachable: true, free: true, position_error_m: 0.05 }, false, "out"],
  [{ reachable: false, free: false, position_error_m: -1 }, false, "out"],
  [{ reachable: false, free: false, position_error_m: 0.05 }, true, "contact"],
] as const)("%o, which was free before: %s, is %s", (check, was_free, reach) => {
  expect(reachOf(check, 0.01, was_free)).toBe(reach);
});
