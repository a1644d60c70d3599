import { BoxGeometry, CylinderGeometry, Group, Mesh, SphereGeometry, Vector3, type BufferGeometry } from "three";
import { expect, test } from "vitest";
import { edgeRadius_m, roundedBox, roundedCylinder, roundShapes } from "./rounded-shapes";

function size(geometry: BufferGeometry): number[] {
  geometry.computeBoundingBox();
  return geometry.boundingBox!.getSize(new Vector3()).toArray().map((value) => Math.round(value * 1e5) / 1e5);
}

/** Distance of the vertex that is the farthest from the middle. */
function farthest_m(geometry: BufferGeometry): number {
  const at = geometry.getAttribute("position");
  const lengths = Array.from({ length: at.count }, (_, index) => new Vector3().fromBufferAttribute(at, index).length());
  return Math.max(...lengths);
}

test("a rounded box fills the bounds of the box, without its corners", () => {
  const box = roundedBox(0.1, 0.04, 0.02);
  expect(size(box)).toEqual([0.1, 0.04, 0.02]);
  expect(farthest_m(box)).toBeLessThan(Math.hypot(0.05, 0.02, 0.01) - 0.001);
});

test("every triangle of a rounded box is seen from outside", () => {
  const box = roundedBox(0.1, 0.04, 0.02);
  const at = box.getAttribute("position");
  const index = box.getIndex()!;
  const corner = (place: number): Vector3 => new Vector3().fromBufferAttribute(at, index.getX(place));
  expect(index.count / 3).toBe(6 * 2 + 12 * 2 + 8);
  for (let first = 0; first < index.count; first += 3) {
    const [a, b, c] = [corner(first), corner(first + 1), corner(first + 2)];
    const normal = b.clone().sub(a).cross(c.clone().sub(a));
    expect(normal.length()).toBeGreaterThan(0);
    expect(normal.dot(a.add(b).add(c))).toBeGreaterThan(0);
  }
});

test("a rounded cylinder fills the bounds of the cylinder, without its rims, and its normals point outward", () => {
  const cylinder = roundedCylinder(0.02, 0.03);
  expect(size(cylinder)).toEqual([0.04, 0.03, 0.04]);
  expect(farthest_m(cylinder)).toBeLessThan(Math.hypot(0.02, 0.015) - 0.001);
  const at = cylinder.getAttribute("position");
  const normals = cylinder.getAttribute("normal");
  for (let index = 0; index < at.count; index += 1) {
    const outward = new Vector3().fromBufferAttribute(at, index).dot(new Vector3().fromBufferAttribute(normals, index));
    expect(outward).toBeGreaterThan(0);
    // Faces are even: only the bevel between them is shaded.
    expect([0, 1]).toContain(Math.abs(normals.getY(index)));
  }
});

test("edges grow with the shape, up to a limit", () => {
  expect(edgeRadius_m(0.01)).toBeCloseTo(0.0022);
  expect(edgeRadius_m(1)).toBe(0.006);
});

test("boxes and cylinders of a description are rounded at their size; spheres and fetched meshes stay", () => {
  const unit = [new BoxGeometry(1, 1, 1), new CylinderGeometry(1, 1, 1, 30), new SphereGeometry(1)];
  const [box, cylinder, sphere]: Mesh[] = unit.map((geometry): Mesh => new Mesh(geometry));
  if (!box || !cylinder || !sphere) throw new Error("three meshes");
  box.scale.set(0.1, 0.2, 0.3);
  cylinder.scale.set(0.02, 0.05, 0.02);
  roundShapes(new Group().add(box, cylinder, sphere));
  expect(size(box.geometry)).toEqual([0.1, 0.2, 0.3]);
  expect(size(cylinder.geometry)).toEqual([0.04, 0.05, 0.04]);
  expect([box.scale.x, cylinder.scale.y]).toEqual([1, 1]);
  expect(sphere.geometry).toBe(unit[2]);
});
