import type { Point } from "../state/state";

/** Direction and opening of a camera. */
export interface CameraOptics {
  /** Unit vector from the framed object to the camera. */
  direction: Point;
  /** Vertical field of view [rad]. */
  field_of_view_rad: number;
  /** Width of the picture over its height. */
  aspect: number;
}

function dot(one: Point, other: Point): number {
  return one[0] * other[0] + one[1] * other[1] + one[2] * other[2];
}

/** Return the picture's axes to the right and up, for a camera with z up. */
function pictureAxes([x, y, z]: Point): [Point, Point] {
  const level = Math.hypot(x, y) || 1;
  const right: Point = [-y / level, x / level, 0];
  return [right, [-right[1] * z, right[0] * z, level]];
}

/** Return the distance from a center at which a camera sees all points in a part of its picture, of 1 at most. */
export function framingDistance_m(points_m: Point[], center_m: Point, optics: CameraOptics, filled: number): number {
  const [right, up] = pictureAxes(optics.direction);
  const tan_up = Math.tan(optics.field_of_view_rad / 2) * filled;
  const tan_right = tan_up * optics.aspect;
  const distances = points_m.map((point): number => {
    const from: Point = [point[0] - center_m[0], point[1] - center_m[1], point[2] - center_m[2]];
    const beside = Math.max(Math.abs(dot(from, right)) / tan_right, Math.abs(dot(from, up)) / tan_up);
    return beside + dot(from, optics.direction);
  });
  return Math.max(...distances);
}
