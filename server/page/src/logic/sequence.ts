import { gripperGoal, jointConstraints } from "../link/messages";
import type { JointValues, Plan } from "../state/state";
import { simplified } from "./polyline";

/** Place that a sequence of motions goes to, and what is done on the way and there. */
export interface Waypoint {
  id: number;
  name: string;
  /** Planning group; empty for the server's default. */
  group: string;
  joints_rad: JointValues;
  /** Taught motion that is replayed on the way there; null for a planned motion. */
  motion: TaughtWay | null;
  /** True for a straight line of the tip, false for any free way. */
  straight: boolean;
  /** Fraction of the speed limits, of a taught motion of the speed in which it was shown; above 0 and up to 1. */
  speed: number;
  /** Position that the gripper goes to after the motion [rad or m]; null leaves it. */
  gripper: number | null;
  pause_s: number;
}

export interface TaughtWay {
  name: string;
  /** Joint values at its start, where the arm goes first. */
  start_rad: JointValues;
}

/** Answer of the server about the motion to a waypoint. */
export interface LegCheck {
  verdict: "checking" | "possible" | "refused" | "unknown";
  message: string;
  duration_s: number;
  /** Joint values at the end, where the next leg begins; null when no motion was found. */
  end_rad: JointValues | null;
  plan: Plan | null;
}

export function poseKey(joints_rad: JointValues): string {
  return JSON.stringify(joints_rad);
}

/** Return the time that a sequence takes without its gripper [s]; null while a leg is not known to be possible. */
export function sequenceDuration_s(waypoints: readonly Waypoint[], checks: readonly LegCheck[]): number | null {
  if (checks.length < waypoints.length || checks.some(({ verdict }) => verdict !== "possible")) return null;
  const moving_s = checks.reduce((sum, { duration_s }) => sum + duration_s, 0);
  return waypoints.reduce((sum, { pause_s }) => sum + pause_s, moving_s);
}

/** Return how far the gripper is open at a waypoint, 0 to 1; null while no waypoint up to it has set the gripper. */
export function openShare(waypoints: readonly Waypoint[], index: number, { open, closed }: { open: number; closed: number }): number | null {
  const position = waypoints.slice(0, index + 1).findLast(({ gripper }) => gripper !== null)?.gripper ?? null;
  return position === null ? null : Math.min(Math.max((position - closed) / (open - closed), 0), 1);
}

/** Part of a sequence that is played: a goal of an action, or a time to wait. */
export type Step =
  | { doing: "motion" | "gripper"; index: number; action: string; type: string; goal: object }
  | { doing: "pause"; index: number; pause_s: number };

/** Largest number of waypoints, as many as the server takes in one request of MoveIt's sequences. */
export const MAX_WAYPOINTS = 50;

export const MAX_PAUSE_S = 600;

/** Slowest motion that can be chosen, as a fraction of the limits. */
export const MIN_SPEED = 0.01;

const REPLAY_ACTION = { action: "/replay_motion", type: "armbridge_msgs/action/ReplayMotion" };
const MOVE_ACTION = { action: "/move_action", type: "moveit_msgs/action/MoveGroup" };
export const GRIPPER_TYPE = "control_msgs/action/GripperCommand";

/** Return a waypoint without what is edited later, numbered after those that there are. */
export function newWaypoint(before: readonly Waypoint[], group: string, joints_rad: JointValues, speed: number): Waypoint {
  const id = 1 + Math.max(0, ...before.map((waypoint) => waypoint.id));
  const values = { joints_rad: rounded(joints_rad), motion: null, straight: false, speed, gripper: null, pause_s: 0 };
  return { id, name: String(id), group, ...values };
}

/** Return a waypoint at the end of a taught motion, which is replayed on the way there. */
export function taughtWaypoint(before: readonly Waypoint[], group: string, name: string, motion: Plan, joints: readonly string[]): Waypoint {
  const [start_rad, end_rad] = [valuesAt(motion, 0, joints), valuesAt(motion, motion.points.length - 1, joints)];
  return { ...newWaypoint(before, group, end_rad, 1), name, motion: { name, start_rad: rounded(start_rad) } };
}

/**
 * Return waypoints along a taught motion, between which straight ways of the joints keep near it.
 *
 * @param joints - those that waypoints move.
 * @param gripper - joint of the gripper, which waypoints move where it was moved; null for an arm without one.
 */
export function asWaypoints(
  before: readonly Waypoint[],
  group: string,
  name: string,
  motion: Plan,
  joints: readonly string[],
  gripper: string | null,
  speed: number,
): Waypoint[] {
  const columns = motion.names.map((joint, index) => ({ joint, index })).filter(({ joint }) => joint === gripper || joints.includes(joint));
  const path = motion.points.map(({ position_rad }) => columns.map(({ index }) => position_rad[index] ?? 0));
  const column = gripper === null ? -1 : motion.names.indexOf(gripper);
  let held: number | null = null;
  const added: Waypoint[] = [];
  for (const [order, index] of simplified(path, KEPT_NEAR).entries()) {
    const waypoint = newWaypoint([...before, ...added], group, valuesAt(motion, index, joints), speed);
    waypoint.name = `${name} ${order + 1}`;
    const position = column < 0 ? null : (motion.points[index]?.position_rad[column] ?? null);
    if (position !== null && (held === null || Math.abs(position - held) > KEPT_NEAR)) {
      waypoint.gripper = held = Number(position.toFixed(5));
    }
    added.push(waypoint);
  }
  return added;
}

/** Greatest distance of a joint from a taught motion on the ways between its waypoints [rad or m], about 3 degrees. */
const KEPT_NEAR = 0.05;

function valuesAt({ names, points }: Plan, index: number, joints: readonly string[]): JointValues {
  const pairs = names.map((name, column) => [name, points[index]?.position_rad[column] ?? 0] as const);
  return Object.fromEntries(pairs.filter(([name]) => joints.includes(name)));
}

/** Return joint values of five decimals, which are finer than a servo's step, so that programs can be read. */
function rounded(joints_rad: JointValues): JointValues {
  return Object.fromEntries(Object.entries(joints_rad).map(([name, value]) => [name, Number(value.toFixed(5))]));
}

/** Return the list with one waypoint at another index; an index beyond an end is that end. */
export function moved(waypoints: readonly Waypoint[], id: number, index: number): Waypoint[] {
  const others = waypoints.filter((waypoint) => waypoint.id !== id);
  const own = waypoints.filter((waypoint) => waypoint.id === id);
  const at = Math.min(Math.max(0, index), others.length);
  return [...others.slice(0, at), ...own, ...others.slice(at)];
}

export function edited(waypoints: readonly Waypoint[], id: number, patch: Partial<Waypoint>): Waypoint[] {
  return waypoints.map((waypoint) => (waypoint.id === id ? { ...waypoint, ...patch } : waypoint));
}

/** Build moveit_msgs/MotionPlanRequest of the planned motion to a waypoint; without a start it begins where the arm is. */
export function legRequest(waypoint: Waypoint, start_rad: JointValues | null = null): object {
  const joint_state = start_rad && { name: Object.keys(start_rad), position: Object.values(start_rad) };
  return {
    group_name: waypoint.group,
    goal_constraints: [jointConstraints(waypoint.joints_rad)],
    max_velocity_scaling_factor: waypoint.speed,
    max_acceleration_scaling_factor: waypoint.speed,
    ...(waypoint.straight ? { pipeline_id: "pilz_industrial_motion_planner", planner_id: "LIN" } : {}),
    ...(joint_state ? { start_state: { joint_state } } : {}),
  };
}

/** Return the steps of playing a sequence, in order; an arm without a gripper has no action for it. */
export function sequenceSteps(waypoints: readonly Waypoint[], gripper_action: string | null): Step[] {
  return waypoints.flatMap((waypoint, index) => {
    const way = waypoint.motion
      ? { ...REPLAY_ACTION, goal: { name: waypoint.motion.name, speed: waypoint.speed, reverse: false, repeat: 0 } }
      : { ...MOVE_ACTION, goal: { request: legRequest(waypoint) } };
    const steps: Step[] = [{ doing: "motion", index, ...way }];
    if (waypoint.gripper !== null && gripper_action !== null) {
      const goal = gripperGoal(waypoint.gripper);
      steps.push({ doing: "gripper", index, action: gripper_action, type: GRIPPER_TYPE, goal });
    }
    if (waypoint.pause_s > 0) steps.push({ doing: "pause", index, pause_s: waypoint.pause_s });
    return steps;
  });
}

export function sequenceText(waypoints: readonly Waypoint[]): string {
  const content = { waypoints: waypoints.map(({ id: _, ...waypoint }) => waypoint) };
  return `${JSON.stringify(content, null, 1)}\n`;
}

/** Return the waypoints of a file's text; null when it has no sequence of up to MAX_WAYPOINTS good ones. */
export function readSequence(text: string): Waypoint[] | null {
  try {
    const content = JSON.parse(text) as { waypoints?: unknown } | null;
    const list = content?.waypoints;
    if (!Array.isArray(list) || list.length > MAX_WAYPOINTS) return null;
    const read = list.map((entry, index) => readWaypoint(entry as Partial<Waypoint> | null, index + 1));
    return read.every((waypoint) => waypoint !== null) ? read : null;
  } catch {
    return null;
  }
}

function readWaypoint(entry: Partial<Waypoint> | null, id: number): Waypoint | null {
  const { name = String(id), group = "", joints_rad, motion = null, straight = false, speed = 1, gripper = null, pause_s = 0 } = entry ?? {};
  if (!areJointValues(joints_rad)) return null;
  const good =
    (motion === null || (typeof motion.name === "string" && areJointValues(motion.start_rad))) &&
    within(speed, MIN_SPEED, 1) &&
    within(pause_s, 0, MAX_PAUSE_S) &&
    (gripper === null || Number.isFinite(gripper)) &&
    [name, group].every((text) => typeof text === "string");
  return good ? { id, name, group, joints_rad, motion, straight: straight === true, speed, gripper, pause_s } : null;
}

function areJointValues(values: unknown): values is JointValues {
  if (typeof values !== "object" || values === null) return false;
  const numbers = Object.values(values);
  return numbers.length > 0 && numbers.every((value) => Number.isFinite(value));
}

function within(value: unknown, lower: number, upper: number): boolean {
  return typeof value === "number" && value >= lower && value <= upper;
}
