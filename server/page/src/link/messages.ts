import type { DiagnosticStatus, JointState, KinematicSolverInfo, MoveItErrorCodes, RobotTrajectory, Time } from "../../../../clients/js/armbridge";
import type { TipVelocity } from "../logic/jog";
import {
  noGoal,
  type ArmHealth,
  type ArmState,
  type Commissioning,
  type Control,
  type GoalState,
  type Identity,
  type Joints,
  type JointValues,
  type LogEntry,
  type NamedState,
  type Orientation,
  type Plan,
  type Point,
  type ServoState,
  type State,
  type SuggestedGoal,
  type SweptJoint,
} from "../state/state";

// Messages of the server, spelled as in ROS 2: JSON has null for a number that is not finite.
export type * from "../../../../clients/js/armbridge";

/** diagnostic_msgs/DiagnosticArray. */
export interface DiagnosticArray {
  status: DiagnosticStatus[];
}

/** rcl_interfaces/Log. */
export interface LogMessage {
  stamp: Time;
  level: number;
  name: string;
  msg: string;
}

/** moveit_msgs/DisplayTrajectory, the field that is shown. */
export interface DisplayTrajectory {
  trajectory: RobotTrajectory[];
}

/** Result of moveit_msgs/action/MoveGroup and, without a trajectory, of ExecuteTrajectory. */
export interface MotionResult {
  error_code: MoveItErrorCodes;
  planned_trajectory?: RobotTrajectory;
}

/** armbridge_msgs/CommissioningState. */
export interface CommissioningMessage extends Omit<Commissioning, "progress" | "joints"> {
  progress: number | null;
  joints: (Omit<SweptJoint, "droop_rad"> & { droop_rad: number | null })[];
}

/** armbridge_msgs/srv/GetServoHistory, the response. */
export interface ServoHistoryResponse {
  /** Times before now, and so negative. */
  time_s: number[];
  temperature_c: (number | null)[];
  load: (number | null)[];
  voltage_v: (number | null)[];
  current_a: (number | null)[];
  events: string[];
}

/** Names of moveit_msgs/MoveItErrorCodes, in MoveIt's spelling. */
const ERROR_CODE_NAMES: Record<number, string> = {
  1: "SUCCESS",
  0: "UNDEFINED",
  99999: "FAILURE",
  [-1]: "PLANNING_FAILED",
  [-2]: "INVALID_MOTION_PLAN",
  [-3]: "MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE",
  [-4]: "CONTROL_FAILED",
  [-5]: "UNABLE_TO_AQUIRE_SENSOR_DATA",
  [-6]: "TIMED_OUT",
  [-7]: "PREEMPTED",
  [-10]: "START_STATE_IN_COLLISION",
  [-11]: "START_STATE_VIOLATES_PATH_CONSTRAINTS",
  [-12]: "GOAL_IN_COLLISION",
  [-13]: "GOAL_VIOLATES_PATH_CONSTRAINTS",
  [-14]: "GOAL_CONSTRAINTS_VIOLATED",
  [-15]: "INVALID_GROUP_NAME",
  [-16]: "INVALID_GOAL_CONSTRAINTS",
  [-17]: "INVALID_ROBOT_STATE",
  [-18]: "INVALID_LINK_NAME",
  [-19]: "INVALID_OBJECT_NAME",
  [-21]: "FRAME_TRANSFORM_FAILURE",
  [-22]: "COLLISION_CHECKING_UNAVAILABLE",
  [-23]: "ROBOT_STATE_STALE",
  [-24]: "SENSOR_INFO_STALE",
  [-25]: "COMMUNICATION_FAILURE",
  [-26]: "START_STATE_INVALID",
  [-27]: "GOAL_STATE_INVALID",
  [-28]: "UNRECOGNIZED_GOAL_TYPE",
  [-29]: "CRASH",
  [-30]: "ABORT",
  [-31]: "NO_IK_SOLUTION",
};

/** moveit_msgs/MoveItErrorCodes.SUCCESS. */
export const SUCCESS = 1;

/** moveit_msgs/MoveItErrorCodes.PREEMPTED: the goal was stopped, or replaced by another. */
export const PREEMPTED = -7;

/** Return the name of an error code, as `NO_IK_SOLUTION`; `code -99` for an unknown one. */
export function errorCodeName(code: number): string {
  return ERROR_CODE_NAMES[code] ?? `code ${code}`;
}

/** std_msgs/Header: the root link, which an empty frame means, and a stamp of zero, which means now. */
export const HEADER = { stamp: { sec: 0, nanosec: 0 }, frame_id: "" };

/** Orientation of what has none of its own. */
const UPRIGHT: Orientation = [0, 0, 0, 1];

/** Build geometry_msgs/Pose. */
export function pose([x, y, z]: Point, orientation: Orientation = UPRIGHT): object {
  return { position: { x, y, z }, orientation: quaternion(orientation) };
}

function quaternion([x, y, z, w]: Orientation): object {
  return { x, y, z, w };
}

/** Build moveit_msgs/Constraints of joint positions. */
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

/** Tolerance of a point goal [m], as for /moveit_goal_pose. */
const POINT_TOLERANCE_M = 0.01;

/** Tolerance of an orientation about each axis [rad]. */
const ORIENTATION_TOLERANCE_RAD = 0.01;

/** Build moveit_msgs/OrientationConstraint of the tip. */
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

/**
 * Build geometry_msgs/TwistStamped.
 *
 * @param frame_id - frame of the axes; empty for the root link.
 * @param shares - velocities by axis, -1 to 1.
 * @param scales - linear and angular velocity of a share of 1.
 */
export function twistStamped(frame_id: string, shares: TipVelocity, [linear, angular]: [number, number]): object {
  const vector = (scale: number, ...values: (number | undefined)[]): object => {
    const [x, y, z] = values.map((value) => (value ?? 0) * scale);
    return { x, y, z };
  };
  const twist = {
    linear: vector(linear, shares.x, shares.y, shares.z),
    angular: vector(angular, shares.roll, shares.pitch, shares.yaw),
  };
  return { header: { ...HEADER, frame_id }, twist };
}

/** Build control_msgs/JointJog of fractions of the joint speed, -1 to 1. */
export function jointJog(velocities: JointValues): object {
  return {
    header: HEADER,
    joint_names: Object.keys(velocities),
    displacements: [],
    velocities: Object.values(velocities),
    duration: 0,
  };
}

export function toSeconds({ sec, nanosec }: Time): number {
  return sec + nanosec * 1e-9;
}

/** Return numbers with NaN for each null. */
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

/** Return the values of a diagnostic_msgs/DiagnosticStatus by key. */
export function keyValues(status: DiagnosticStatus): Record<string, string> {
  return Object.fromEntries(status.values.map(({ key, value }) => [key, value]));
}

/** Read a message of /arm/state. */
export function readArmState(status: DiagnosticStatus): ArmState {
  const values = keyValues(status);
  const share = (key: string): number => {
    const value = Number(values[key] ?? 1);
    return Number.isFinite(value) ? value : 1;
  };
  return {
    mode: values.mode ?? "disconnected",
    message: status.message,
    fault: values.fault ?? "",
    fault_message: values.fault_message ?? "",
    fault_remedy: values.fault_remedy ?? "",
    fault_joint: values.fault_joint ?? "",
    reason: values.reason ?? "",
    speed_factor: share("speed_factor"),
    speed_limit: share("speed_limit"),
    course: values.course ?? "forward",
    last_stop: values.last_stop ?? "",
  };
}

/** Read a message of /arm/control. */
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

/** Read the answer of /arm/who_am_i; null when it is not valid. */
export function readIdentity(text: string): Identity | null {
  try {
    const { address, role, version } = JSON.parse(text) as Partial<Identity>;
    const has_role = role === "view" || role === "propose" || role === "operate" || role === "admin";
    return typeof address === "string" && has_role ? { address, role, version: version ?? "" } : null;
  } catch {
    return null;
  }
}

/** Read a message of /moveit_goal_status. */
export function readGoal(status: DiagnosticStatus): GoalState {
  const values = keyValues(status);
  const code = values.code === undefined ? null : Number(values.code);
  const seconds_left = Number(values.seconds_left);
  return {
    ...noGoal(),
    id: status.hardware_id,
    source: status.name,
    state: values.state ?? "",
    fraction: Number(values.fraction ?? 0) || 0,
    seconds_left: Number.isFinite(seconds_left) ? seconds_left : null,
    message: status.message,
    code,
    suggestion: readSuggestion(values.suggested_goal),
  };
}

function readSuggestion(text: string | undefined): SuggestedGoal | null {
  if (text === undefined) return null;
  try {
    const goal = JSON.parse(text) as SuggestedGoal;
    return typeof goal.topic === "string" && typeof goal.type === "string" ? goal : null;
  } catch {
    return null;
  }
}

/** Read the soft limits of /arm/joint_limits, for a joint without limits those of a whole turn. */
export function readLimits({ limits }: KinematicSolverInfo): Record<string, [number, number]> {
  const range = (limit: KinematicSolverInfo["limits"][number]): [number, number] => {
    const { has_position_limits: limited, min_position: low, max_position: high } = limit;
    return limited && typeof low === "number" && typeof high === "number" ? [low, high] : [-Math.PI, Math.PI];
  };
  return Object.fromEntries(limits.map((limit) => [limit.joint_name, range(limit)]));
}

/** Read the JSON of /named_states; an empty record when it is not valid. */
export function readNamedStates(text: string): Record<string, NamedState> {
  try {
    return JSON.parse(text) as Record<string, NamedState>;
  } catch {
    return {};
  }
}

/** Read a message of /rosout. */
export function readLogEntry(message: LogMessage): LogEntry {
  return { stamp: toSeconds(message.stamp), level: message.level, name: message.name, text: message.msg };
}

/** Read the servos among the statuses of /diagnostics. */
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

/** Read a message of /arm/commissioning/state. */
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
