import { Box3, MeshBasicMaterial, Vector3, type BufferGeometry } from "three";
import { describe, expect, it } from "vitest";
import type { Point, Shape } from "../state/state";
import { shapeMesh } from "./scene-objects";

const MATERIAL = new MeshBasicMaterial();

function shape(kind: Shape["kind"], patch: Partial<Shape>): Shape {
  const empty = { dimensions: [], vertices: [], triangles: [] };
  return { kind, position_m: [0, 0, 0], orientation: [0, 0, 0, 1], ...empty, ...patch };
}

function extent(one: Shape): { min: Point; max: Point } {
  const box = new Box3().setFromObject(shapeMesh(one, MATERIAL));
  const rounded = (corner: Vector3): Point => corner.toArray().map(round) as Point;
  return { min: rounded(box.min), max: rounded(box.max) };
}

function round(value: number): number {
  // Adding 0 makes 0 of -0.
  return Math.round(value * 1e4) / 1e4 + 0;
}

function volume_m3(geometry: BufferGeometry): number {
  const flat = geometry.index === null ? geometry : geometry.toNonIndexed();
  const corners = flat.getAttribute("position");
  const at = (index: number): Vector3 => new Vector3().fromBufferAttribute(corners, index);
  let sum = 0;
  for (let index = 0; index < corners.count; index += 3) sum += at(index).dot(at(index + 1).cross(at(index + 2))) / 6;
  return sum;
}

describe("shapeMesh", () => {
  it("stands cylinders and cones along z, height first", () => {
    const cylinder = extent(shape("cylinder", { dimensions: [0.4, 0.1] }));
    expect(cylinder).toEqual({ min: [-0.1, -0.1, -0.2], max: [0.1, 0.1, 0.2] });
    const cone = shapeMesh(shape("cone", { dimensions: [0.4, 0.1] }), MATERIAL).geometry;
    const corners = cone.getAttribute("position");
    const tops = Array.from({ length: corners.count }, (_, index) => corners.getZ(index)).filter((z) => z > 0.19);
    expect(tops.length).toBeGreaterThan(0);
    expect(extent(shape("cone", { dimensions: [0.4, 0.1] })).max[2]).toBe(0.2);
  });
  it("puts a shape where its pose says", () => {
    const turned = shape("box", { dimensions: [0.2, 0.4, 0.6], position_m: [1, 0, 0], orientation: [0, 0, 1, 1] });
    expect(extent(turned)).toEqual({ min: [0.8, -0.1, -0.3], max: [1.2, 0.1, 0.3] });
  });
  it("lays a plane through its nearest point", () => {
    const plane = extent(shape("plane", { dimensions: [0, 0, 2, -1] }));
    expect(plane).toEqual({ min: [-0.5, -0.5, 0.5], max: [0.5, 0.5, 0.5] });
  });
  it("closes a prism, also one that is not convex", () => {
    const vertices: Point[] = [[0, 0, 0], [0.2, 0, 0], [0.1, 0.1, 0], [0.2, 0.2, 0], [0, 0.2, 0]];
    const prism = shapeMesh(shape("prism", { dimensions: [0.5], vertices }), MATERIAL);
    expect(volume_m3(prism.geometry)).toBeCloseTo(0.03 * 0.5, 6);
  });
  it("draws a mesh's triangles", () => {
    const vertices: Point[] = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]];
    const triangles: Shape["triangles"] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    const mesh = shapeMesh(shape("mesh", { vertices, triangles }), MATERIAL);
    expect(volume_m3(mesh.geometry)).toBeCloseTo(0.001 / 6, 9);
  });
});
