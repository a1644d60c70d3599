import { Box3, type CircleGeometry, Mesh, MeshBasicMaterial, Object3D, PlaneGeometry, Vector3 } from "three";
import { expect, test } from "vitest";
import { Sector, type AxisJoint } from "./swept-range";

const material = new MeshBasicMaterial();

/** Joint about an axis, with a link along x. */
function joint(axis: Vector3): AxisJoint {
  const link = new Mesh(new PlaneGeometry(0.02, 0.02), material);
  link.position.x = 0.1;
  return Object.assign(new Object3D(), { axis }).add(link) as AxisJoint;
}

function bounds(of: AxisJoint, lowest_rad: number, highest_rad: number): Box3 {
  const before = [...of.children];
  const sector = new Sector(of, material, material);
  sector.show(lowest_rad, highest_rad);
  const group = of.children.find((child) => !before.includes(child));
  of.updateWorldMatrix(true, true);
  // The first is the fan, the second the line at the present position.
  const box = new Box3().setFromObject(group!.children[0]!);
  sector.dispose();
  expect(of.children).toEqual(before);
  return box;
}

test("the sector lies in the plane of rotation, from the lowest to the highest angle, zero along the link", () => {
  const box = bounds(joint(new Vector3(0, 0, 1)), 0, Math.PI / 2);
  expect(box.min.toArray().map((value) => Math.round(value * 1e6))).toEqual([0, 0, 0]);
  expect(box.max.x).toBeCloseTo(0.1, 2);
  expect(box.max.y).toBeCloseTo(0.1, 2);
});

test("an axis that points the other way turns the sector", () => {
  const box = bounds(joint(new Vector3(0, 0, -1)), 0, Math.PI / 2);
  expect(box.min.y).toBeCloseTo(-0.1, 2);
  expect(box.max.y).toBeCloseTo(0, 6);
});

test("a joint that turns about its own link has a sector across it", () => {
  const box = bounds(joint(new Vector3(1, 0, 0)), -Math.PI, Math.PI);
  expect(box.max.x - box.min.x).toBeCloseTo(0, 6);
  expect(box.max.y).toBeGreaterThan(0.04);
});

test("it is no more than a whole turn", () => {
  const about = joint(new Vector3(0, 0, 1));
  new Sector(about, material, material).show(0, 5 * Math.PI);
  const fan = about.children.at(-1)?.children[0] as Mesh<CircleGeometry>;
  expect(fan.geometry.parameters.thetaLength).toBeCloseTo(2 * Math.PI);
});
