import { noGoal } from "../state/state";
import type {
  ArmState,
  Control,
  GoalState,
  Identity,
  JointValues,
  Joints,
  LogEntry,
  NamedState,
  Plan,
  ServoState,
  SuggestedGoal,
} from "../state/state";
import type {
  DiagnosticStatus,
  JointState,
  KinematicSolverInfo,
  Log,
  RobotTrajectory,
  Time,
} from "./wire";

/** A time in seconds. */
export function seconds({ sec, nanosec }: Time): number {
  return sec + nanosec * 1e-9;
}

/** Numbers as they came; what is none is not a number. */
function numbers(values: readonly (number | null)[] | undefined): number[] {
  return (values ?? []).map((value) => (typeof value === "number" ? value : Number.NaN));
}

/** The joints of a sensor_msgs/JointState; names without a position get one that is not a number. */
export function joints(message: JointState): Joints {
  const position_rad = numbers(message.position);
  return {
    names: message.name,
    position_rad: message.name.map((_, index) => position_rad[index] ?? Number.NaN),
    velocity: numbers(message.velocity),
    effort: numbers(message.effort),
    stamp: seconds(message.header.stamp),
  };
}

/** Values by joint; joints without a number are left out. */
export function byName(names: readonly string[], values: readonly (number | null)[]): JointValues {
  const pairs = names.map((name, index) => [name, values[index]] as const);
  return Object.fromEntries(pairs.filter((pair): pair is [string, number] => Number.isFinite(pair[1])));
}

/** The values of a diagnostic_msgs/DiagnosticStatus by key. */
export function keyed(status: DiagnosticStatus): Record<string, string> {
  return Object.fromEntries(status.values.map(({ key, value }) => [key, value]));
}

/** What /arm/state says. */
export function arm(status: DiagnosticStatus): ArmState {
  const values = keyed(status);
  const speed_factor = Number(values["speed_factor"] ?? 1);
  return {
    mode: values["mode"] ?? "disconnected",
    message: status.message,
    fault: values["fault"] ?? "",
    fault_message: values["fault_message"] ?? "",
    fault_remedy: values["fault_remedy"] ?? "",
    fault_joint: values["fault_joint"] ?? "",
    reason: values["reason"] ?? "",
    speed_factor: Number.isFinite(speed_factor) ? speed_factor : 1,
    course: values["course"] ?? "forward",
  };
}

/** What /arm/control says. */
export function control(status: DiagnosticStatus): Control {
  const values = keyed(status);
  const free_in_s = values["free_in_s"] || "none";
  return {
    holder: status.hardware_id,
    address: values["address"] ?? "",
    policy: values["policy"] === "shared" ? "shared" : "lease",
    free_in_s: Number.isFinite(Number(free_in_s)) ? Math.max(0, Number(free_in_s)) : null,
  };
}

/** What /arm/who_am_i answers; null when it cannot be read. */
export function identity(text: string): Identity | null {
  try {
    const { address, role } = JSON.parse(text) as Partial<Identity>;
    const known = role === "view" || role === "operate" || role === "admin";
    return typeof address === "string" && known ? { address, role } : null;
  } catch {
    return null;
  }
}

/** What /moveit_goal_status says of a goal. */
export function goal(status: DiagnosticStatus): GoalState {
  const values = keyed(status);
  const code = values["code"] === undefined ? null : Number(values["code"]);
  const left = Number(values["seconds_left"]);
  return {
    ...noGoal(),
    id: status.hardware_id,
    source: status.name,
    state: values["state"] ?? "",
    fraction: Number(values["fraction"] ?? 0) || 0,
    seconds_left: Number.isFinite(left) ? left : null,
    message: status.message,
    code,
    suggestion: suggestion(values["suggested_goal"]),
  };
}

function suggestion(text: string | undefined): SuggestedGoal | null {
  if (text === undefined) return null;
  try {
    const found = JSON.parse(text) as SuggestedGoal;
    return typeof found.topic === "string" && typeof found.type === "string" ? found : null;
  } catch {
    return null;
  }
}

/** The soft limits that /arm/joint_limits tells. */
export function limits(message: KinematicSolverInfo): Record<string, [number, number]> {
  const limited = message.limits.filter((limit) => limit.has_position_limits);
  return Object.fromEntries(limited.map((limit) => [limit.joint_name, [limit.min_position, limit.max_position]]));
}

/** The named states in /named_states; none when the text cannot be read. */
export function named(text: string): Record<string, NamedState> {
  try {
    return JSON.parse(text) as Record<string, NamedState>;
  } catch {
    return {};
  }
}

/** An entry of the log. */
export function logEntry(message: Log): LogEntry {
  return { stamp: seconds(message.stamp), level: message.level, name: message.name, text: message.msg };
}

/** The servos in a diagnostic_msgs/DiagnosticArray. */
export function servos(statuses: readonly DiagnosticStatus[]): ServoState[] {
  const found = statuses.filter((status) => status.hardware_id.startsWith("servo "));
  return found.map((status) => ({
    name: status.name.replace(/^.*: /, ""),
    level: status.level,
    message: status.message,
    values: keyed(status),
  }));
}

/** A motion as it is shown; null when it has no points. */
export function plan(trajectory: RobotTrajectory | undefined): Plan | null {
  const motion = trajectory?.joint_trajectory;
  if (!motion || motion.points.length === 0) return null;
  return {
    names: motion.joint_names,
    points: motion.points.map((point) => ({
      time_s: seconds(point.time_from_start),
      position_rad: point.positions,
    })),
  };
}
