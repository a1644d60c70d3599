import type { JointValues, Plan } from "../state/state";

/** How long a plan takes, in seconds. */
export function duration_s(plan: Plan): number {
  return plan.points.at(-1)?.time_s ?? 0;
}

/** Where the joints are at a time of a plan, between its points in a straight line; its ends hold beyond it. */
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

/** Times that are evenly spread over a plan, both ends included, in seconds. */
export function sampleTimes_s(plan: Plan, count: number): number[] {
  const end_s = duration_s(plan);
  return Array.from({ length: count }, (_, index) => (end_s * index) / (count - 1));
}
