import * as THREE from "three";

// Share of the shortest edge, and its limit: an edge of 6 mm already looks like a printed part of that size.
const EDGE_SHARE = 0.22;
const MAX_EDGE_M = 0.006;
const CYLINDER_SEGMENTS = 20;

/** Return the radius of the edges of a shape with a shortest edge [m]. */
export function edgeRadius_m(shortest_m: number): number {
  return Math.min(Math.abs(shortest_m) * EDGE_SHARE, MAX_EDGE_M);
}

/**
 * Create a box with edges that look round; it fills the same bounds as the box.
 *
 * Each edge is one flat bevel between the vertices of two faces, whose normals are interpolated over it: 24 vertices
 * instead of the 900 of three's RoundedBoxGeometry, which took 40 % of a frame in software.
 */
export function roundedBox(x_m: number, y_m: number, z_m: number): THREE.BufferGeometry {
  const half_m = [x_m / 2, y_m / 2, z_m / 2];
  const edge_m = edgeRadius_m(Math.min(x_m, y_m, z_m));
  const positions: number[] = [];
  const normals: number[] = [];
  for (let corner = 0; corner < 8; corner += 1) {
    const signs = AXES_OF_BOX.map((axis) => (corner & (1 << axis) ? 1 : -1));
    for (const face of AXES_OF_BOX) {
      positions.push(...AXES_OF_BOX.map((axis) => signs[axis]! * (half_m[axis]! - (axis === face ? 0 : edge_m))));
      normals.push(...AXES_OF_BOX.map((axis) => (axis === face ? signs[axis]! : 0)));
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(positions), 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(normals), 3));
  geometry.setIndex(BOX_TRIANGLES);
  return geometry;
}

const AXES_OF_BOX = [0, 1, 2] as const;

/** Triangles of a box with bevels: vertex 3 c + a is the one of corner c on its face across axis a. */
const BOX_TRIANGLES = boxTriangles();

function boxTriangles(): number[] {
  const triangles: number[] = [];
  // Seen from outside, a triangle goes round against the clock; mirrored corners turn it over.
  const add = (a: number, b: number, c: number, turned: boolean): void => {
    triangles.push(...(turned ? [a, c, b] : [a, b, c]));
  };
  const bit = (axis: number): number => 1 << axis;
  for (const axis of AXES_OF_BOX) {
    const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
    for (const side of [0, bit(axis)]) {
      // The face across this axis.
      const at = (corner: number): number => 3 * corner + axis;
      const [a, b, c, d] = [side, side | bit(u), side | bit(u) | bit(v), side | bit(v)];
      add(at(a), at(b), at(c), side === 0);
      add(at(a), at(c), at(d), side === 0);
    }
    for (const corner of [0, bit(u), bit(v), bit(u) | bit(v)]) {
      // The bevel along this axis, between the faces across the two others.
      const far = corner | bit(axis);
      const turned = (corner & bit(u)) === 0 === ((corner & bit(v)) === 0);
      add(3 * corner + u, 3 * far + u, 3 * far + v, turned);
      add(3 * corner + u, 3 * far + v, 3 * corner + v, turned);
    }
  }
  for (let corner = 0; corner < 8; corner += 1) {
    const mirrored = [0, 1, 2].filter((axis) => (corner & bit(axis)) === 0).length % 2 === 1;
    add(3 * corner, 3 * corner + 1, 3 * corner + 2, mirrored);
  }
  return triangles;
}

/** Create a cylinder about y with rims that look round, each one flat bevel as with the box; it fills the same bounds. */
export function roundedCylinder(radius_m: number, length_m: number): THREE.BufferGeometry {
  const edge_m = edgeRadius_m(Math.min(radius_m, length_m));
  const [end_m, side_m] = [length_m / 2, length_m / 2 - edge_m];
  const profile = [[0, -end_m], [radius_m - edge_m, -end_m], [radius_m, -side_m], [radius_m, side_m], [radius_m - edge_m, end_m], [0, end_m]];
  const geometry = new THREE.LatheGeometry(profile.map(([out_m, y_m]) => new THREE.Vector2(out_m, y_m)), CYLINDER_SEGMENTS);
  const { position: at, normal } = geometry.attributes as Record<string, THREE.BufferAttribute>;
  for (let vertex = 0; vertex < at!.count; vertex += 1) {
    const out = profile[vertex % profile.length]![0] === radius_m ? 1 / radius_m : 0;
    normal!.setXYZ(vertex, out * at!.getX(vertex), out === 0 ? Math.sign(at!.getY(vertex)) : 0, out * at!.getZ(vertex));
  }
  return geometry;
}

export function roundShapes(shape: THREE.Object3D): void {
  shape.traverse((node) => {
    if (!(node instanceof THREE.Mesh)) return;
    const rounded = roundedOf(node as THREE.Mesh);
    if (rounded === null) return;
    node.geometry.dispose();
    node.geometry = rounded;
    node.scale.set(1, 1, 1);
  });
}

/** Return the rounded form of urdf-loader's unit box or cylinder, whose scale is its size; null for other meshes. */
function roundedOf({ geometry, scale }: THREE.Mesh): THREE.BufferGeometry | null {
  if (geometry instanceof THREE.BoxGeometry) return roundedBox(scale.x, scale.y, scale.z);
  return geometry instanceof THREE.CylinderGeometry ? roundedCylinder(scale.x, scale.y) : null;
}
