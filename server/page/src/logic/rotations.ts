import type { Orientation } from "../state/state";

/** Roll, pitch and yaw [rad]: rotations about the fixed axes x, y and z, in this order, as in URDF. */
export type RollPitchYaw = [number, number, number];

/** Axes of a place, in the order of its coordinates. */
export const AXES = ["x", "y", "z"] as const;

/** Rotations about the fixed axes x, y and z, with their limits [rad]. */
export const ROTATIONS = [["roll", Math.PI], ["pitch", Math.PI / 2], ["yaw", Math.PI]] as const;

/** Distance of the pitch's sine from 1 at which roll and yaw turn about the same axis. */
const GIMBAL_LOCK = 1e-9;

export function quaternionOf([roll, pitch, yaw]: RollPitchYaw): Orientation {
  const [cr, sr] = [Math.cos(roll / 2), Math.sin(roll / 2)];
  const [cp, sp] = [Math.cos(pitch / 2), Math.sin(pitch / 2)];
  const [cy, sy] = [Math.cos(yaw / 2), Math.sin(yaw / 2)];
  return [
    sr * cp * cy - cr * sp * sy,
    cr * sp * cy + sr * cp * sy,
    cr * cp * sy - sr * sp * cy,
    cr * cp * cy + sr * sp * sy,
  ];
}

/** Return roll, pitch (within a quarter turn of zero) and yaw of a unit quaternion; where they are ambiguous, no roll. */
export function rollPitchYawOf([x, y, z, w]: Orientation): RollPitchYaw {
  const sine = 2 * (w * y - x * z);
  if (Math.abs(sine) >= 1 - GIMBAL_LOCK) {
    return [0, (Math.sign(sine) * Math.PI) / 2, Math.atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z))];
  }
  const roll = Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
  return [roll, Math.asin(sine), Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))];
}
