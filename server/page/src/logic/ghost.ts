import type { JointValues, State } from "../state/state";
import { duration_s, samplePlan } from "./trajectory";

/** What the ghost shows. */
export interface GhostPose {
  joints_rad: JointValues;
  /** How far the tool stays from the target, in metres; null when it gets there. */
  off_target_m: number | null;
}

/** The pose of the ghost: the plan if there is one, else what is wished for; null without either. */
export function ghostPose(state: Pick<State, "plan" | "target" | "wish">): GhostPose | null {
  const { plan, target, wish } = state;
  if (plan.trajectory !== null) {
    const time_s = plan.scrub_s ?? duration_s(plan.trajectory);
    return { joints_rad: samplePlan(plan.trajectory, time_s), off_target_m: null };
  }
  if (wish.kind === "target") {
    if (target.joints_rad === null) return null;
    return { joints_rad: target.joints_rad, off_target_m: target.reachable === false ? target.distance_m : null };
  }
  if (wish.kind === "none" || wish.joints_rad === null) return null;
  return { joints_rad: wish.joints_rad, off_target_m: null };
}

/** A distance as the page writes it: "3 mm", "12.3 cm". */
export function distanceText(distance_m: number): string {
  if (distance_m < 0.01) return `${Math.max(1, Math.round(distance_m * 1000))} mm`;
  return `${(distance_m * 100).toFixed(1)} cm`;
}
