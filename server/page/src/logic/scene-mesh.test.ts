import { expect, test } from "vitest";
import { fileProblem, makeMesh, MAX_FILE_BYTES } from "./scene-mesh";

/** Two triangles that make a square of a unit's edge, away from the origin. */
const SQUARE = [5, 5, 5, 6, 5, 5, 6, 6, 5, 5, 5, 5, 6, 6, 5, 5, 6, 5];

test("corners are shared, scaled to metres and about the middle", () => {
  const { vertices, triangles, deviation_m } = makeMesh(SQUARE, 0.001);
  expect(vertices).toHaveLength(4);
  expect(triangles).toEqual([[0, 1, 2], [0, 2, 3]]);
  expect(vertices[0]?.map((value) => Number(value.toFixed(6)))).toEqual([-0.0005, -0.0005, 0]);
  expect(deviation_m).toBe(0);
});

/** A wavy surface of 2 x count x count triangles over a square metre. */
function wavy(count: number): number[] {
  const at = (row: number, column: number): number[] => [row / count, column / count, 0.05 * Math.sin(row) * Math.sin(column)];
  const corners: number[] = [];
  for (let row = 0; row < count; row += 1) {
    for (let column = 0; column < count; column += 1) {
      const [a, b, c, d] = [at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)];
      corners.push(...a, ...b, ...c, ...a, ...c, ...d);
    }
  }
  return corners;
}

test("too many triangles are made fewer, and the distance that corners were moved is told", () => {
  const { triangles, vertices, deviation_m } = makeMesh(wavy(60), 1, 2000);
  expect(triangles.length).toBeLessThanOrEqual(2000);
  expect(triangles.length).toBeGreaterThan(500);
  expect(deviation_m).toBeGreaterThan(0);
  expect(deviation_m).toBeLessThan(0.1);
  expect(triangles.flat().every((index) => index < vertices.length)).toBe(true);
});

test("a mesh of 300 000 triangles is made so few that the server takes it", () => {
  const { triangles } = makeMesh(wavy(390), 1);
  expect(triangles.length).toBeLessThanOrEqual(80_000);
  expect(triangles.length).toBeGreaterThan(20_000);
}, 60_000);

test("a mesh without an area, or with a coordinate that is none, is refused with a reason", () => {
  expect(() => makeMesh([], 1)).toThrow("no triangle");
  expect(() => makeMesh([0, 0, 0, 0, 0, 0, 1, 1, 1], 1)).toThrow("no triangle");
  expect(() => makeMesh([0, 0, 0, 1, 0, 0, Number.NaN, 1, 1], 1)).toThrow("corner 2");
});

test.each([
  ["cup.STL", 1000, null],
  ["cup.dae", MAX_FILE_BYTES, null],
  ["cup.stl", 100_000_000, "large"],
  ["cup.png", 1000, "kind"],
  ["cup", 1000, "kind"],
])("the file %s of %d bytes has the problem %s", (name, size, problem) => {
  expect(fileProblem(name, size)?.key ?? null).toBe(problem);
});

test("a file of 100 MB is refused with its size and the limit", () => {
  expect(fileProblem("cup.stl", 100_000_000)?.values).toEqual({ name: "cup.stl", size: "100", limit: "30" });
});
