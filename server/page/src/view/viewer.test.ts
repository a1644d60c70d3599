import { Box3, PerspectiveCamera, Vector3 } from "three";
import { expect, test } from "vitest";
import { placeCamera } from "./viewer";

const box = new Box3(new Vector3(0, -0.05, 0), new Vector3(0.4, 0.05, 0.3));
const corners = [0, 0.4].flatMap((x) => [-0.05, 0.05].flatMap((y) => [0, 0.3].map((z) => new Vector3(x, y, z))));

test.each([0.5, 1, 2.2])("all corners fill most of a picture of aspect %f, and no more", (aspect) => {
  const camera = new PerspectiveCamera(40, aspect, 0.01, 20);
  camera.up.set(0, 0, 1);
  camera.lookAt(placeCamera(camera, box, (40 * Math.PI) / 180, aspect));
  camera.updateMatrixWorld();
  const reached = corners.flatMap((corner) => corner.clone().project(camera).toArray().slice(0, 2).map(Math.abs));
  expect(Math.max(...reached)).toBeCloseTo(0.86, 3);
});
