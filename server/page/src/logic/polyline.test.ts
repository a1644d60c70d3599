import { expect, it } from "vitest";
import { simplified } from "./polyline";

it("keeps the ends alone of a straight way", () => {
  expect(simplified([[0, 0], [1, 2], [2, 4], [3, 6]], 0.01)).toEqual([0, 3]);
});

it("keeps corners that are further from the line than the tolerance", () => {
  const path = [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2]];
  expect(simplified(path, 0.1)).toEqual([0, 2, 4]);
  expect(simplified(path, 2)).toEqual([0, 4]);
});

it("keeps the turning point of a way there and back", () => {
  expect(simplified([[0], [1], [0.5], [0]], 0.1)).toEqual([0, 1, 3]);
});

it("has nothing to keep of no path, and both ends of one that rests", () => {
  expect(simplified([], 0.1)).toEqual([]);
  expect(simplified([[1], [1], [1]], 0.1)).toEqual([0, 2]);
});
