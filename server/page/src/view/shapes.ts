import {
  BoxGeometry,
  BufferGeometry,
  ConeGeometry,
  CylinderGeometry,
  Float32BufferAttribute,
  Mesh,
  PlaneGeometry,
  Quaternion,
  ShapeUtils,
  SphereGeometry,
  Vector2,
  Vector3,
  type Material,
} from "three";
import { planeFrame, prismSides, type Surface } from "../logic/shapes";
import type { Point, Shape } from "../state/state";
import { quaternion } from "./figure";

const SEGMENTS = 24;
// A plane has no end; a piece of it as large as the table tells where it is.
const PLANE_EDGE_M = 1;
const UP = new Vector3(0, 0, 1);

/** Draws a shape of the planning scene, in the pose that it has in its object. */
export function shapeMesh(shape: Shape, material: Material): Mesh {
  const mesh = new Mesh(geometryOf(shape), material);
  mesh.position.set(...shape.position_m);
  mesh.quaternion.copy(quaternion(shape.orientation));
  return mesh;
}

function geometryOf(shape: Shape): BufferGeometry {
  const [first = 0, second = 0, third = 0] = shape.dimensions;
  switch (shape.kind) {
    case "box":
      return new BoxGeometry(first, second, third);
    case "sphere":
      return new SphereGeometry(first, SEGMENTS, SEGMENTS / 2);
    // three's cylinders stand along y, those of ROS along z; height comes before radius there.
    case "cylinder":
      return new CylinderGeometry(second, second, first, SEGMENTS).rotateX(Math.PI / 2);
    case "cone":
      return new ConeGeometry(second, first, SEGMENTS).rotateX(Math.PI / 2);
    case "plane":
      return plane(shape.dimensions);
    case "prism":
      return surface(prism(shape.vertices, first));
    case "mesh":
      return surface(shape);
  }
}

function plane(coefficients: number[]): BufferGeometry {
  const { point_m, normal } = planeFrame(coefficients);
  const turn = new Quaternion().setFromUnitVectors(UP, new Vector3(...normal));
  return new PlaneGeometry(PLANE_EDGE_M, PLANE_EDGE_M).applyQuaternion(turn).translate(...point_m);
}

function prism(polygon: Point[], height_m: number): Surface {
  const sides = prismSides(polygon, height_m);
  const cap = ShapeUtils.triangulateShape(polygon.map(([x, y]) => new Vector2(x, y)), []);
  const triangles = cap.flatMap((corners): Surface["triangles"] => {
    const [a = 0, b = 0, c = 0] = corners;
    const above = polygon.length;
    return [
      [c, b, a],
      [a + above, b + above, c + above],
    ];
  });
  return { vertices: sides.vertices, triangles: [...sides.triangles, ...triangles] };
}

function surface({ vertices, triangles }: Surface): BufferGeometry {
  // Corners are not shared, so that edges look like edges.
  const corners = triangles.flat().flatMap((index) => vertices[index] ?? [0, 0, 0]);
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(corners, 3));
  geometry.computeVertexNormals();
  return geometry;
}
