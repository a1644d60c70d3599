import type { JointValues, Plan, State } from "../state/state";

export function duration_s(plan: Plan): number {
  return plan.points.at(-1)?.time_s ?? 0;
}

/** Return the joint values at a time of a plan, interpolated linearly and held beyond its ends. */
export function samplePlan(plan: Plan, time_s: number): JointValues {
  const next = plan.points.findIndex((point) => point.time_s >= time_s);
  const after = plan.points[next] ?? plan.points.at(-1);
  if (after === undefined) return {};
  const before = next > 0 ? (plan.points[next - 1] ?? after) : after;
  const span_s = after.time_s - before.time_s;
  const share = span_s > 0 ? Math.min(Math.max((time_s - before.time_s) / span_s, 0), 1) : 1;
  const values: JointValues = {};
  plan.names.forEach((name, index) => {
    const from = before.position_rad[index];
    const to = after.position_rad[index];
    if (from !== undefined && to !== undefined) values[name] = from + share * (to - from);
  });
  return values;
}

/** Return evenly spaced times of a plan, both ends included, in seconds. */
export function sampleTimes_s(plan: Plan, count: number): number[] {
  const end_s = duration_s(plan);
  return Array.from({ length: count }, (_, index) => (end_s * index) / (count - 1));
}

export interface GhostPose {
  joints_rad: JointValues;
  /** Distance of the tool from a target out of reach, in metres; null when it gets there. */
  off_target_m: number | null;
}

/** Return the pose of the ghost: that of the plan, else of the selected goal; null without either. */
export function ghostPose(state: Pick<State, "plan" | "target" | "selection">): GhostPose | null {
  const { plan, target, selection } = state;
  if (plan.trajectory !== null) {
    const time_s = plan.scrub_s ?? duration_s(plan.trajectory);
    return { joints_rad: samplePlan(plan.trajectory, time_s), off_target_m: null };
  }
  if (selection.kind === "target") {
    if (target.joints_rad === null) return null;
    return { joints_rad: target.joints_rad, off_target_m: target.reachable === false ? target.distance_m : null };
  }
  if (selection.kind === "none" || selection.joints_rad === null) return null;
  return { joints_rad: selection.joints_rad, off_target_m: null };
}
