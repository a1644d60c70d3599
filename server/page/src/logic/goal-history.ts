import type { GoalState, Plan, PlanPoint, State } from "../state/state";
import { jointKind } from "./joints";
import { positionText, unitOf } from "./numbers";

export const MAX_GOALS = 100;

export interface GoalEntry {
  goal: GoalState;
  /** Time of its first and of its newest status [s since 1970]; equal for a goal that the server told of afterwards. */
  began_s: number;
  stamp_s: number;
}

/** Return the history, oldest first, with a goal's newest status; of more goals the oldest are left out. */
export function withStatus(history: readonly GoalEntry[], goal: GoalState, now_s: number): GoalEntry[] {
  const known = history.findIndex((entry) => entry.goal.id === goal.id);
  const before = history[known];
  // A server that was started anew counts from 1 again.
  if (before === undefined || (before.goal.state === "done" && goal.state !== "done")) {
    return [...history.filter((entry) => entry !== before), { goal, began_s: now_s, stamp_s: now_s }].slice(-MAX_GOALS);
  }
  return history.map((entry, index) => (index === known ? { ...entry, goal, stamp_s: now_s } : entry));
}

/** Return the history that the server tells, with the goals in progress that it cannot know the answer of yet. */
export function fromServer(told: readonly GoalEntry[], history: readonly GoalEntry[]): GoalEntry[] {
  const ids = new Set(told.map(({ goal }) => goal.id));
  const in_progress = history.filter(({ goal }) => goal.state !== "done" && !ids.has(goal.id));
  const begun = new Map(history.map((entry) => [entry.goal.id, entry]));
  const known = told.map((entry) => {
    const before = begun.get(entry.goal.id);
    const same = before !== undefined && before.goal.source === entry.goal.source && before.began_s <= entry.stamp_s;
    return same ? { ...entry, began_s: before.began_s } : entry;
  });
  return [...known, ...in_progress].slice(-MAX_GOALS);
}

const KINDS: [RegExp, GoalKind][] = [
  [/moveit_goal_named$/, "named"],
  [/moveit_goal_joints$/, "joints"],
  [/moveit_goal_pose$/, "pose"],
  [/execute_trajectory$/, "execute"],
  [/move_action$|sequence_move_group$/, "move"],
  [/follow_joint_trajectory$|joint_trajectory$/, "trajectory"],
];
export type GoalKind = "named" | "joints" | "pose" | "move" | "execute" | "trajectory" | "other";

export function goalKind(source: string): GoalKind {
  return KINDS.find(([pattern]) => pattern.test(source))?.[1] ?? "other";
}

/** Request of a client in a few words' worth: a name, joints, or a point; null for one that takes more words. */
export type Asked = { kind: "named"; name: string } | { kind: "joints"; text: string } | { kind: "point"; point: string[]; unit: string } | null;

interface JointList {
  name: string[];
  position: number[];
}

/** Units of choice, and the robot, whose joints may slide. */
type ShownUnits = Pick<State, "robot" | "settings">;

/** Read what a client asked for from its message as JSON. */
export function readAsked(text: string, shown: ShownUnits): Asked {
  try {
    return askedOf(JSON.parse(text) as Record<string, unknown>, shown);
  } catch {
    // Long messages come cut off.
    return null;
  }
}

function askedOf(message: Record<string, unknown>, shown: ShownUnits): Asked {
  if (typeof message.data === "string") return { kind: "named", name: message.data };
  const joints = message as unknown as JointList;
  if (Array.isArray(joints.name) && Array.isArray(joints.position)) {
    return { kind: "joints", text: jointsText(joints, shown) };
  }
  const goals = (message.request as { goal_constraints?: GoalConstraints[] } | undefined)?.goal_constraints;
  const constraints = goals?.[0]?.joint_constraints ?? [];
  if (goals?.length === 1 && constraints.length > 0) {
    const list = { name: constraints.map((each) => each.joint_name), position: constraints.map((each) => each.position) };
    return { kind: "joints", text: jointsText(list, shown) };
  }
  const region = goals?.[0]?.position_constraints?.[0]?.constraint_region.primitive_poses[0];
  const pose = (message.pose as PoseFields | undefined) ?? region;
  if (pose?.position === undefined) return null;
  const { x, y, z } = pose.position;
  const unit = unitOf("prismatic", shown.settings.units);
  return { kind: "point", point: [x, y, z].map((value) => positionText(value, unit)), unit: unit.suffix.trim() };
}

interface PoseFields {
  position: { x: number; y: number; z: number };
}

interface GoalConstraints {
  joint_constraints?: { joint_name: string; position: number }[];
  position_constraints?: { constraint_region: { primitive_poses: PoseFields[] } }[];
}

function jointsText({ name, position }: JointList, shown: ShownUnits): string {
  const texts = name.map((joint, index) => {
    const unit = unitOf(jointKind(shown, joint), shown.settings.units);
    return `${joint} ${positionText(position[index] ?? Number.NaN, unit)}${unit.suffix}`;
  });
  return texts.join(", ");
}

/** Return several plans as one, one after the other; joints that a plan does not move keep their value. */
export function joinedPlan(plans: readonly Plan[]): Plan | null {
  if (plans.length <= 1) return plans[0] ?? null;
  const names = [...new Set(plans.flatMap((plan) => plan.names))];
  const held: Record<string, number> = {};
  // What a later plan moves first stands until then where that plan begins.
  for (const plan of [...plans].reverse()) plan.names.forEach((name, index) => (held[name] = plan.points[0]?.position_rad[index] ?? 0));
  const points: PlanPoint[] = [];
  let begin_s = 0;
  for (const plan of plans) {
    for (const { time_s, position_rad } of plan.points) {
      plan.names.forEach((name, index) => (held[name] = position_rad[index] ?? held[name] ?? 0));
      points.push({ time_s: begin_s + time_s, position_rad: names.map((name) => held[name] ?? 0) });
    }
    begin_s += plan.points.at(-1)?.time_s ?? 0;
  }
  return { names, points };
}
