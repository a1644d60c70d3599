import { describe, expect, it } from "vitest";
import type { Shape } from "../state/state";
import { planeFrame, prismSides, shapeProblem } from "./shapes";

const BOX: Shape = {
  kind: "box",
  position_m: [0, 0, 0],
  orientation: [0, 0, 0, 1],
  dimensions: [0.1, 0.2, 0.3],
  vertices: [],
  triangles: [],
};

describe("shapeProblem", () => {
  it("accepts whole shapes", () => {
    expect(shapeProblem(BOX)).toBe("");
    expect(shapeProblem({ ...BOX, kind: "plane", dimensions: [0, 0, 1, -0.2] })).toBe("");
    expect(shapeProblem({ ...BOX, kind: "mesh", vertices: [[0, 0, 0]], triangles: [[0, 0, 0]] })).toBe("");
  });
  it.each<[string, Partial<Shape>, string]>([
    ["missing sizes", { dimensions: [0.1] }, "3 sizes, not 1"],
    ["sizes that are no numbers", { dimensions: [0.1, Number.NaN, 0.1] }, "a number that is none"],
    ["sizes of zero", { dimensions: [0.1, 0, 0.1] }, "size of 0 m"],
    ["NaN", { position_m: [0, Number.NaN, 0] }, "a number that is none"],
    ["a plane without direction", { kind: "plane", dimensions: [0, 0, 0, 1] }, "no direction"],
    ["an empty mesh", { kind: "mesh" }, "no triangles"],
    ["a corner that is not there", { kind: "mesh", vertices: [[0, 0, 0]], triangles: [[0, 1, 0]] }, "corner 1 of 1"],
    ["a prism of two corners", { kind: "prism", dimensions: [1], vertices: [[0, 0, 0], [1, 0, 0]] }, "2 corners"],
  ])("refuses %s", (_, patch, phrase) => {
    expect(shapeProblem({ ...BOX, ...patch })).toContain(phrase);
  });
});

describe("prismSides", () => {
  it("joins two rings", () => {
    const { vertices, triangles } = prismSides([[0, 0, 0], [1, 0, 0], [0, 1, 0]], 2);
    expect(vertices[0]).toEqual([0, 0, -1]);
    expect(vertices[5]).toEqual([0, 1, 1]);
    expect(triangles).toHaveLength(6);
    expect(triangles.flat().every((index) => index < 6)).toBe(true);
  });
});

describe("planeFrame", () => {
  it("finds the nearest point and the normal", () => {
    expect(planeFrame([0, 0, 2, -1])).toEqual({ point_m: [0, 0, 0.5], normal: [0, 0, 1] });
  });
});
