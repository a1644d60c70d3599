import { gripperGoal, jointConstraints } from "../link/messages";
import type { JointValues } from "../state/state";

/** Place that a sequence of motions goes to, and what is done on the way and there. */
export interface Waypoint {
  /** Unique within the sequence. */
  id: number;
  name: string;
  /** Planning group; empty for the server's default. */
  group: string;
  joints_rad: JointValues;
  /** True for a straight line of the tip, false for any free way. */
  straight: boolean;
  /** Fraction of the speed limits, above 0 and up to 1. */
  speed: number;
  /** Position that the gripper goes to after the motion [rad or m]; null leaves it. */
  gripper: number | null;
  /** Time to wait there. */
  pause_s: number;
}

/** Answer of the server about the motion to a waypoint. */
export interface LegCheck {
  verdict: "checking" | "possible" | "refused" | "unknown";
  /** Sentence of the server; empty without one. */
  message: string;
  duration_s: number;
  /** Joint values at the end, where the next leg begins; null when no motion was found. */
  end_rad: JointValues | null;
}

/** Part of a sequence that is played: a goal of an action, or a time to wait. */
export type Step =
  | { doing: "motion" | "gripper"; index: number; action: string; type: string; goal: object }
  | { doing: "pause"; index: number; pause_s: number };

/** Largest number of waypoints, as many as the server takes in one request of MoveIt's sequences. */
export const MAX_WAYPOINTS = 50;

/** Longest wait at a waypoint [s]. */
export const MAX_PAUSE_S = 600;

/** Slowest motion that can be chosen, as a fraction of the limits. */
export const MIN_SPEED = 0.01;

const MOVE_ACTION = { action: "/move_action", type: "moveit_msgs/action/MoveGroup" };
export const GRIPPER_TYPE = "control_msgs/action/GripperCommand";

/** Return a waypoint without what is edited later, numbered after those that there are. */
export function newWaypoint(before: readonly Waypoint[], group: string, joints_rad: JointValues, speed: number): Waypoint {
  const id = 1 + Math.max(0, ...before.map((waypoint) => waypoint.id));
  return { id, name: String(id), group, joints_rad: rounded(joints_rad), straight: false, speed, gripper: null, pause_s: 0 };
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

/** Return the list with fields of one waypoint replaced. */
export function edited(waypoints: readonly Waypoint[], id: number, patch: Partial<Waypoint>): Waypoint[] {
  return waypoints.map((waypoint) => (waypoint.id === id ? { ...waypoint, ...patch } : waypoint));
}

/** Build moveit_msgs/MotionPlanRequest of the motion to a waypoint; without a start it begins where the arm is. */
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

/**
 * Return what playing a sequence does, in order.
 *
 * @param gripper_action - action of the gripper; null for an arm without one.
 */
export function sequenceSteps(waypoints: readonly Waypoint[], gripper_action: string | null): Step[] {
  return waypoints.flatMap((waypoint, index) => {
    const steps: Step[] = [{ doing: "motion", index, ...MOVE_ACTION, goal: { request: legRequest(waypoint) } }];
    if (waypoint.gripper !== null && gripper_action !== null) {
      const goal = gripperGoal(waypoint.gripper);
      steps.push({ doing: "gripper", index, action: gripper_action, type: GRIPPER_TYPE, goal });
    }
    if (waypoint.pause_s > 0) steps.push({ doing: "pause", index, pause_s: waypoint.pause_s });
    return steps;
  });
}

/** Return the text of a file with a sequence. */
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
  const { name = String(id), group = "", joints_rad, straight = false, speed = 1, gripper = null, pause_s = 0 } = entry ?? {};
  if (typeof joints_rad !== "object" || joints_rad === null) return null;
  const values = Object.values(joints_rad);
  const good =
    values.length > 0 &&
    values.every((value) => Number.isFinite(value)) &&
    within(speed, MIN_SPEED, 1) &&
    within(pause_s, 0, MAX_PAUSE_S) &&
    (gripper === null || Number.isFinite(gripper)) &&
    [name, group].every((text) => typeof text === "string");
  return good ? { id, name, group, joints_rad, straight: straight === true, speed, gripper, pause_s } : null;
}

function within(value: unknown, lower: number, upper: number): boolean {
  return typeof value === "number" && value >= lower && value <= upper;
}
