import { Matrix3, Plane, Raycaster, Vector2, Vector3, type Camera, type Object3D } from "three";
import type { SurfacePoint } from "../state/state";

/** Ground that objects stand on: the plane z = 0 of the root link. */
const GROUND = new Plane(new Vector3(0, 0, 1), 0);

/** Farthest point that counts [m]: near the horizon a click has no certain place. */
const MAX_DISTANCE_M = 2;

/** Return the nearest surface under a pointer, of some objects or the ground; null where there is none. */
export function surfaceAt(
  { clientX, clientY }: Pick<MouseEvent, "clientX" | "clientY">,
  canvas: HTMLCanvasElement,
  camera: Camera,
  objects: Object3D[],
): SurfacePoint | null {
  const box = canvas.getBoundingClientRect();
  const ray = new Raycaster();
  ray.setFromCamera(new Vector2(((clientX - box.left) / box.width) * 2 - 1, 1 - ((clientY - box.top) / box.height) * 2), camera);
  const hit = ray.intersectObjects(objects, true)[0];
  if (hit?.face) {
    const turn = new Matrix3().getNormalMatrix(hit.object.matrixWorld);
    const normal = hit.face.normal.clone().applyNormalMatrix(turn);
    // A mesh may have its triangles the other way round.
    if (normal.dot(ray.ray.direction) > 0) normal.negate();
    return { point_m: hit.point.toArray(), normal: normal.toArray() };
  }
  const point = ray.ray.intersectPlane(GROUND, new Vector3());
  if (point === null || point.length() > MAX_DISTANCE_M) return null;
  return { point_m: point.toArray(), normal: [0, 0, 1] };
}
