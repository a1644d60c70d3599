// Parts of a handle, in units of its size: the arrow begins beyond the gripper and ends at 1.
export const HANDLE_START = 0.5;
export const HANDLE_END = 1;
// Smallest and largest length on the screen, as a share of the picture's height.
const MIN_SHARE = 0.13;
const MAX_SHARE = 0.3;

/** Return the length of the target's handles, which begin beyond half the width of the gripper, for the height of the picture there. */
export function handleLength_m(clearance_m: number, picture_m: number): number {
  return Math.min(Math.max(clearance_m / HANDLE_START, MIN_SHARE * picture_m), MAX_SHARE * picture_m);
}

/** Return the half width of a gripper from the sizes of its bounds: that of the middle one, as fingers are long. */
export function gripperClearance_m(sizes_m: readonly number[]): number {
  const sorted = sizes_m.filter(Number.isFinite).sort((one, other) => one - other);
  return Math.max(0, (sorted[1] ?? 0) / 2);
}
