import type { State } from "../state/state";
import { armJoints, currentPositions, groupPoses } from "./joints";

/** Least travel of a joint that one sees as a motion [rad or m]. */
const LEAST_TRAVEL = 0.2;

/** Return the described pose that is nearest to the arm among those that it visibly moves to; null without one. */
export function firstPose(state: State): string | null {
  const current = currentPositions(state);
  const limits = state.limits;
  const names = armJoints(state);
  const candidates = Object.entries(groupPoses(state)).flatMap(([name, { saved, joints }]) => {
    const inside = Object.entries(joints).every(([joint, value]) => {
      const [lower, upper] = limits[joint] ?? [-Infinity, Infinity];
      return value >= lower && value <= upper;
    });
    const travel = Math.max(0, ...names.map((joint) => Math.abs((joints[joint] ?? Number.NaN) - (current[joint] ?? Number.NaN))));
    return !saved && inside && travel >= LEAST_TRAVEL ? [{ name, travel }] : [];
  });
  // The shortest way is the one that surprises least.
  candidates.sort((one, other) => one.travel - other.travel);
  return candidates[0]?.name ?? null;
}
