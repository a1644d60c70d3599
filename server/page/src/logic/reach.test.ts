import { expect, test } from "vitest";
import type { Point } from "../state/state";
import { reachOutline, SECTORS } from "./reach";

const [UPPER_M, LOWER_M] = [0.2, 0.15];

/** Arm of two links that turns by 180 degrees about z at a point and bends upward. */
function tool([turn, lift, bend]: readonly number[]): Point {
  const pan = (turn! - 0.5) * Math.PI;
  const first = lift! * Math.PI * 0.5;
  const second = first + (bend! - 0.5) * Math.PI;
  const out = UPPER_M * Math.cos(first) + LOWER_M * Math.cos(second);
  return [0.1 + out * Math.cos(pan), out * Math.sin(pan), UPPER_M * Math.sin(first) + LOWER_M * Math.sin(second)];
}

test("the outline lies at the stretched arm, where it turns to", () => {
  const { radius_m } = reachOutline(tool, 3, [0.1, 0]);
  const front = radius_m.filter((_, sector) => sector < SECTORS / 4 - 2 || sector > (3 * SECTORS) / 4 + 2);
  expect(Math.max(...front)).toBeLessThanOrEqual(UPPER_M + LOWER_M);
  expect(Math.min(...front)).toBeGreaterThan(0.93 * (UPPER_M + LOWER_M));
});

test("behind the arm it is what a folded arm reaches", () => {
  const { radius_m } = reachOutline(tool, 3, [0.1, 0]);
  expect(radius_m[SECTORS / 2]).toBeLessThan(0.6 * (UPPER_M + LOWER_M));
});

test("the same arm gives the same outline", () => {
  expect(reachOutline(tool, 3, [0.1, 0])).toEqual(reachOutline(tool, 3, [0.1, 0]));
});

test("a tool without numbers has no outline", () => {
  expect(reachOutline(() => [Number.NaN, 0, 0], 1, [0, 0]).radius_m.every((value) => value === 0)).toBe(true);
});
