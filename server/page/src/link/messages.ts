import type { DiagnosticStatus, JointState, KinematicSolverInfo, Messages, MoveItErrorCodes, RobotTrajectory, Time } from "../../../../clients/js/armbridge";
import type { TipVelocity } from "../logic/jog";
import {
  NO_GOAL, type ArmHealth, type ArmState, type Commissioning, type Control, type GoalState, type Joints, type JointValues,
  type LogEntry, type Orientation, type Plan, type Point, type ServoState, type State, type SuggestedGoal, type SweptJoint,
} from "../state/state";

// Messages of the server, spelled as in ROS 2: JSON has null for a number that is not finite.
export type * from "../../../../clients/js/armbridge";

/** Messages of the topics that the page subscribes to, with the fields that it reads. */
export interface Received extends Messages {
  "armbridge_msgs/msg/CommissioningState": CommissioningMessage;
  "diagnostic_msgs/msg/DiagnosticArray": { status: DiagnosticStatus[] };
  "moveit_msgs/msg/DisplayTrajectory": { trajectory: RobotTrajectory[] };
  "rcl_interfaces/msg/Log": { stamp: Time; level: number; name: string; msg: string };
}

/** Result of moveit_msgs/action/MoveGroup and, without a trajectory, of ExecuteTrajectory. */
export interface MotionResult {
  error_code: MoveItErrorCodes;
  planned_trajectory?: RobotTrajectory;
}

export interface CommissioningMessage extends Omit<Commissioning, "progress" | "joints"> {
  progress: number | null;
  joints: (Omit<SweptJoint, "droop_rad"> & { droop_rad: number | null })[];
}

export interface ServoHistoryResponse {
  /** Times before now, and so negative. */
  time_s: number[];
  temperature_c: (number | null)[];
  load: (number | null)[];
  voltage_v: (number | null)[];
  current_a: (number | null)[];
  events: string[];
}

/** Names of moveit_msgs/MoveItErrorCodes by their value, from the type tables of the protocol (vite.config.ts). */
declare const __ERROR_CODE_NAMES__: Record<number, string>;

export const SUCCESS = 1;

/** moveit_msgs/MoveItErrorCodes.PREEMPTED: the goal was stopped, or replaced by another. */
export const PREEMPTED = -7;

/** Return the name of an error code, as `NO_IK_SOLUTION`; `code -99` for an unknown one. */
export function errorCodeName(code: number): string {
  return __ERROR_CODE_NAMES__[code] ?? `code ${code}`;
}

/** std_msgs/Header: the root link, which an empty frame means, and a stamp of zero, which means now. */
export const HEADER = { stamp: { sec: 0, nanosec: 0 }, frame_id: "" };

const UPRIGHT: Orientation = [0, 0, 0, 1];

export function pose([x, y, z]: Point, orientation: Orientation = UPRIGHT): object {
  return { position: { x, y, z }, orientation: quaternion(orientation) };
}

function quaternion([x, y, z, w]: Orientation): object {
  return { x, y, z, w };
}

export function jointConstraints(joints_rad: JointValues): object {
  const joint_constraints = Object.entries(joints_rad).map(([joint_name, position]) => ({
    joint_name,
    position,
    // Room for rounding errors; the planner goes to the middle.
    tolerance_above: 1e-4,
    tolerance_below: 1e-4,
    weight: 1,
  }));
  return { joint_constraints };
}

/** Build moveit_msgs/Constraints of the tip, which an empty link name means, within a ball. */
export function positionConstraints(position_m: Point, radius_m: number): object {
  const sphere = { type: 2, dimensions: [radius_m] };
  const constraint_region = { primitives: [sphere], primitive_poses: [pose(position_m)] };
  return { position_constraints: [{ header: HEADER, link_name: "", constraint_region, weight: 1 }] };
}

/** Distance of the tip from a point within which it counts as reached [m], as for /moveit_goal_pose. */
export const POINT_TOLERANCE_M = 0.01;

/** Tolerance of an orientation about each axis [rad]. */
const ORIENTATION_TOLERANCE_RAD = 0.01;

function orientationConstraint(orientation: Orientation): object {
  return {
    header: HEADER,
    orientation: quaternion(orientation),
    link_name: "",
    absolute_x_axis_tolerance: ORIENTATION_TOLERANCE_RAD,
    absolute_y_axis_tolerance: ORIENTATION_TOLERANCE_RAD,
    absolute_z_axis_tolerance: ORIENTATION_TOLERANCE_RAD,
    weight: 1,
  };
}

/** Build the goal of /move_action; an empty group name means the server's default group. */
export function moveGroupGoal(constraints: object, speed: number, plan_only: boolean, group_name: string): object {
  const request = {
    group_name,
    goal_constraints: [constraints],
    max_velocity_scaling_factor: speed,
    max_acceleration_scaling_factor: speed,
  };
  return { request, planning_options: { plan_only } };
}

/** Build moveit_msgs/Constraints of the selected goal; null when nothing is selected. */
export function goalConstraints({ selection, target }: Pick<State, "selection" | "target">): object | null {
  if (selection.kind === "none") return null;
  if (selection.kind !== "target") return selection.joints_rad && jointConstraints(selection.joints_rad);
  if (!target.position_m) return null;
  // The joint values that the ghost shows, as a point alone may be reached in another configuration.
  if (target.reachable && target.joints_rad) return jointConstraints(target.joints_rad);
  const point = positionConstraints(target.position_m, POINT_TOLERANCE_M);
  if (!target.orientation) return point;
  return { ...point, orientation_constraints: [orientationConstraint(target.orientation)] };
}

/** Build the request of armbridge_msgs/srv/CheckGoals for poses; a group of few joints leaves the orientation out. */
export function checkGoalsRequest(positions_m: readonly Point[], orientation: Orientation | null): object {
  const poses = positions_m.map((position_m) => ({ header: HEADER, pose: pose(position_m, orientation ?? UPRIGHT) }));
  return { poses, joints: [] };
}

/** Build the goal of control_msgs/action/GripperCommand [rad or m]; an effort of 0 means the maximum. */
export function gripperGoal(position: number): object {
  return { command: { position, max_effort: 0 } };
}

/** Build geometry_msgs/TwistStamped of shares, -1 to 1, of a linear and an angular velocity; an empty frame is the root link. */
export function twistStamped(frame_id: string, shares: TipVelocity, [linear, angular]: [number, number]): object {
  const vector = (scale: number, ...values: (number | undefined)[]): object => {
    const [x, y, z] = values.map((value) => (value ?? 0) * scale);
    return { x, y, z };
  };
  const twist = {
    linear: vector(linear, shares.x, shares.y, shares.z),
    angular: vector(angular, shares.roll, shares.pitch, shares.yaw),
  };
  return { header: { stamp: now(), frame_id }, twist };
}

/** Return the time of this machine, by which the server sees how long a command was under way. */
const now = (ms = Date.now()): Time => ({ sec: Math.floor(ms / 1000), nanosec: (ms % 1000) * 1e6 });

/** Build control_msgs/JointJog of fractions of the joint speed, -1 to 1. */
export function jointJog(velocities: JointValues): object {
  return {
    header: { ...HEADER, stamp: now() },
    joint_names: Object.keys(velocities),
    displacements: [],
    velocities: Object.values(velocities),
    duration: 0,
  };
}

export function toSeconds({ sec, nanosec }: Time): number {
  return sec + nanosec * 1e-9;
}

export function readNumbers(values: readonly (number | null)[] | undefined): number[] {
  return (values ?? []).map((value) => (typeof value === "number" ? value : Number.NaN));
}

/** Read sensor_msgs/JointState; a joint without a position gets NaN. */
export function readJoints(message: JointState): Joints {
  const position_rad = readNumbers(message.position);
  return {
    names: message.name,
    position_rad: message.name.map((_, index) => position_rad[index] ?? Number.NaN),
    velocity: readNumbers(message.velocity),
    effort: readNumbers(message.effort),
    stamp: toSeconds(message.header.stamp),
  };
}

/** Return values by joint name, without joints that have no finite value. */
export function valuesByJoint(names: readonly string[], values: readonly (number | null)[]): JointValues {
  const pairs = names.map((name, index) => [name, values[index]] as const);
  return Object.fromEntries(pairs.filter((pair): pair is [string, number] => Number.isFinite(pair[1])));
}

export function keyValues(status: DiagnosticStatus): Record<string, string> {
  return Object.fromEntries(status.values.map(({ key, value }) => [key, value]));
}

export function readArmState(status: DiagnosticStatus): ArmState {
  const values = keyValues(status);
  const share = (key: string): number => {
    const value = Number(values[key] ?? 1);
    return Number.isFinite(value) ? value : 1;
  };
  return {
    // While its torque is lowered, an arm that holds sinks.
    mode: values.mode === "holding" && values.task === "relaxing" ? "relaxing" : (values.mode ?? "disconnected"),
    message: status.message,
    fault: values.fault ?? "",
    fault_message: values.fault_message ?? "",
    fault_remedy: values.fault_remedy ?? "",
    fault_joint: values.fault_joint ?? "",
    reason: values.reason ?? "",
    task: values.task ?? "",
    speed_factor: share("speed_factor"),
    speed_limit: share("speed_limit"),
    course: values.course ?? "forward",
    last_stop: values.last_stop ?? "",
  };
}

export function readControl(status: DiagnosticStatus): Control {
  const values = keyValues(status);
  const free_in_s = values.free_in_s || "none";
  return {
    holder: status.hardware_id,
    address: values.address ?? "",
    policy: values.policy === "shared" ? "shared" : "lease",
    free_in_s: Number.isFinite(Number(free_in_s)) ? Math.max(0, Number(free_in_s)) : null,
  };
}

export function readGoal(status: DiagnosticStatus): GoalState {
  const values = keyValues(status);
  const code = values.code === undefined ? null : Number(values.code);
  const seconds_left = Number(values.seconds_left);
  return {
    ...NO_GOAL,
    id: status.hardware_id,
    source: status.name,
    state: values.state ?? "",
    fraction: Number(values.fraction ?? 0) || 0,
    seconds_left: Number.isFinite(seconds_left) ? seconds_left : null,
    message: status.message,
    code,
    suggestion: values.suggested_goal === undefined ? null : (JSON.parse(values.suggested_goal) as SuggestedGoal),
  };
}

/** Read the soft limits of /arm/joint_limits, for a joint without limits those of a whole turn. */
export function readLimits({ limits }: KinematicSolverInfo): Record<string, [number, number]> {
  const range = (limit: KinematicSolverInfo["limits"][number]): [number, number] => {
    const { has_position_limits: limited, min_position: low, max_position: high } = limit;
    return limited && typeof low === "number" && typeof high === "number" ? [low, high] : [-Math.PI, Math.PI];
  };
  return Object.fromEntries(limits.map((limit) => [limit.joint_name, range(limit)]));
}

export function readLogEntry({ stamp, level, name, msg: text }: Received["rcl_interfaces/msg/Log"]): LogEntry {
  return { stamp: toSeconds(stamp), level, name, text };
}

export function readServos(statuses: readonly DiagnosticStatus[]): ServoState[] {
  const servos = statuses.filter((status) => status.hardware_id.startsWith("servo "));
  return servos.map((status) => ({
    name: status.name.replace(/^.*: /, ""),
    hardware: status.hardware_id,
    level: status.level,
    message: status.message,
    values: keyValues(status),
  }));
}

/** Read the arm among the statuses of /diagnostics: the one with its port; null while it has none. */
export function readArmHealth(statuses: readonly DiagnosticStatus[]): ArmHealth | null {
  const status = statuses.find(({ values }) => values.some(({ key }) => key === "port"));
  return status ? { level: status.level, message: status.message, values: keyValues(status) } : null;
}

export function readCommissioning(message: CommissioningMessage): Commissioning {
  const joints = message.joints.map((joint) => ({ ...joint, droop_rad: joint.droop_rad ?? Number.NaN }));
  return { ...message, progress: message.progress ?? 0, joints };
}

/** Read moveit_msgs/RobotTrajectory; null when it has no points. */
export function readPlan(trajectory: Pick<RobotTrajectory, "joint_trajectory"> | undefined): Plan | null {
  const joint_trajectory = trajectory?.joint_trajectory;
  if (!joint_trajectory || joint_trajectory.points.length === 0) return null;
  return {
    names: joint_trajectory.joint_names,
    points: joint_trajectory.points.map((point) => ({
      time_s: toSeconds(point.time_from_start),
      position_rad: point.positions,
    })),
  };
}
