import { Euler, Quaternion } from "three";
import type { Orientation } from "../state/state";

/** Roll, pitch and yaw [rad]: rotations about the fixed axes x, y and z, in this order, as in URDF. */
export type RollPitchYaw = [number, number, number];

export const AXES = ["x", "y", "z"] as const;

/** Rotations about the fixed axes x, y and z, with their limits [rad]. */
export const ROTATIONS = [["roll", Math.PI], ["pitch", Math.PI / 2], ["yaw", Math.PI]] as const;

export function quaternionOf([roll, pitch, yaw]: RollPitchYaw): Orientation {
  // Fixed axes in one order are moving axes in the other one.
  return new Quaternion().setFromEuler(new Euler(roll, pitch, yaw, "ZYX")).toArray();
}

/** Return roll, pitch (within a quarter turn of zero) and yaw of a unit quaternion; where they are ambiguous, no roll. */
export function rollPitchYawOf(orientation: Orientation): RollPitchYaw {
  const { x, y, z } = new Euler().setFromQuaternion(new Quaternion(...orientation), "ZYX");
  return [x, y, z];
}
