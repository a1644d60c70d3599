import { Box3, BoxGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import { expect, test } from "vitest";
import { mergeShapes } from "./merged-shapes";

function shape(mesh: Mesh, x_m: number, turned_rad = 0): Group {
  const group = new Group().add(mesh);
  group.position.x = x_m;
  group.rotation.z = turned_rad;
  return group;
}

function bounds(link: Group): number[] {
  link.updateWorldMatrix(true, true);
  const { min, max } = new Box3().setFromObject(link, true);
  return [...min.toArray(), ...max.toArray()].map((value) => Math.round(value * 1e6) / 1e6);
}

function meshes(link: Group): Mesh[] {
  const found: Mesh[] = [];
  link.traverse((node) => node instanceof Mesh && found.push(node));
  return found;
}

test("shapes of one material become one mesh that fills the same space", () => {
  const yellow = new MeshBasicMaterial();
  const link = new Group().add(
    shape(new Mesh(new BoxGeometry(0.2, 0.1, 0.1), yellow), 0.3, 1),
    shape(new Mesh(new SphereGeometry(0.05), yellow), -0.3, 0.2),
    shape(new Mesh(new BoxGeometry(0.1, 0.1, 0.1).toNonIndexed(), yellow), 0.5),
  );
  link.position.set(1, 2, 3);
  const before = bounds(link);
  mergeShapes(link.children);
  expect(meshes(link)).toHaveLength(1);
  expect(bounds(link)).toEqual(before);
});

test("shapes of different materials stay apart", () => {
  const link = new Group().add(
    shape(new Mesh(new BoxGeometry(1, 1, 1), new MeshBasicMaterial()), 0),
    shape(new Mesh(new BoxGeometry(1, 1, 1), new MeshBasicMaterial()), 1),
  );
  mergeShapes(link.children);
  expect(meshes(link)).toHaveLength(2);
});

test("a mirrored shape stays apart, as its triangles would be turned inside out", () => {
  const yellow = new MeshBasicMaterial();
  const mirrored = shape(new Mesh(new BoxGeometry(1, 1, 1), yellow), 2);
  mirrored.scale.x = -1;
  const link = new Group().add(shape(new Mesh(new BoxGeometry(1, 1, 1), yellow), 0), mirrored);
  mergeShapes(link.children);
  expect(meshes(link)).toHaveLength(2);
});
