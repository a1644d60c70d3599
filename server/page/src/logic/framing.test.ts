import { PerspectiveCamera, Vector3 } from "three";
import { expect, test } from "vitest";
import type { Point } from "../state/state";
import { framingDistance_m } from "./framing";

const corners: Point[] = [0, 0.4].flatMap((x) => [-0.05, 0.05].flatMap((y) => [0, 0.3].map((z): Point => [x, y, z])));
const center: Point = [0.2, 0, 0.15];
const direction = new Vector3(0.75, -0.85, 0.55).normalize();

/** Return the greatest share of the picture's half that a corner takes, as three projects it. */
function reached(aspect: number, distance_m: number): number {
  const camera = new PerspectiveCamera(40, aspect, 0.01, 20);
  camera.up.set(0, 0, 1);
  camera.position.set(...center).addScaledVector(direction, distance_m);
  camera.lookAt(...center);
  camera.updateMatrixWorld();
  const projected = corners.map((corner) => new Vector3(...corner).project(camera));
  return Math.max(...projected.flatMap(({ x, y }) => [Math.abs(x), Math.abs(y)]));
}

test.each([0.5, 1, 2.2])("all corners fill the wished part of a picture of aspect %f, and no more", (aspect) => {
  const optics = { direction: direction.toArray() as Point, field_of_view_rad: (40 * Math.PI) / 180, aspect };
  expect(reached(aspect, framingDistance_m(corners, center, optics, 0.8))).toBeCloseTo(0.8, 3);
});
