import type { GoalEntry } from "../logic/goal-history";
import { INITIAL_LAYOUT, type Layout } from "../logic/layout";
import type { RobotInfo } from "../logic/robot-info";
import type { LegCheck, Step, Waypoint } from "../logic/sequence";

// Everything that the page shows: link/ and the user's input write it, panel/ and view/ read it.

/** Position in the root link's frame. */
export type Point = [number, number, number];

/** Orientation in the root link's frame, as a unit quaternion: x, y, z, w. */
export type Orientation = [number, number, number, number];

/** Joint values by joint name, in radians (metres for a joint that slides). */
export type JointValues = Record<string, number>;

export interface ConnectionState {
  connected: boolean;
  /** Round-trip time of the last heartbeat; null before the first answer. */
  latency_ms: number | null;
  url: string;
  /** Server's reason for rejecting the page, until another token is tried; empty when it accepts it. */
  refused: string;
}

export interface Identity {
  /** IP address and port of the connection, which are unique to it. */
  address: string;
  role: "view" | "propose" | "operate" | "admin";
  version: string;
}

export interface Control {
  /** Name of the client that controls the arm; empty while none does. */
  holder: string;
  address: string;
  /** One client at a time (lease), or all (shared). */
  policy: "lease" | "shared";
  /** Time after which an idle holder loses control; null without a holder. */
  free_in_s: number | null;
}

/** State of this page's token; the token itself is in sessionStorage. */
export interface TokenState {
  held: boolean;
  asked: boolean;
}

export interface Joints {
  names: string[];
  /** NaN where the message had no number. */
  position_rad: number[];
  velocity: number[];
  effort: number[];
  /** Time at which the servos were read, in seconds. */
  stamp: number;
}

export interface ArmState {
  /** Mode of the state machine; empty before the server has told it. */
  mode: string;
  message: string;
  /** Code of the fault; empty without one, as are the next three. */
  fault: string;
  fault_message: string;
  fault_remedy: string;
  fault_joint: string;
  reason: string;
  task: string;
  speed_factor: number;
  speed_limit: number;
  course: string;
  /** Number of the last stop, anyone's; another number means another stop. */
  last_stop: string;
}

export interface SuggestedGoal {
  topic: string;
  type: string;
  msg: unknown;
}

export interface GoalState {
  id: string;
  /** Topic or action that it came by. */
  source: string;
  state: string;
  fraction: number;
  seconds_left: number | null;
  message: string;
  /** MoveIt's error code; null while there is none. */
  code: number | null;
  suggestion: SuggestedGoal | null;
}

export interface StopState {
  phase: "ready" | "asked" | "acknowledged" | "failed";
  text: string;
}

export type PendingRequest = "nothing" | "plan" | "move";

export interface Settings {
  units: "deg" | "rad";
  /** Fraction of the joints' speed limits, above 0 and up to 1. */
  speed: number;
}

export interface PlanPoint {
  time_s: number;
  position_rad: number[];
}

export interface Plan {
  names: string[];
  points: PlanPoint[];
}

export interface PlanState {
  trajectory: Plan | null;
  /** Path of the tool, which the view computes from the URDF; empty without a plan. */
  tool_path: Point[];
  /** Time on the plan at which the ghost is shown; null means the end. */
  scrub_s: number | null;
  /** False for the plan of a goal of the past, which is shown alone. */
  executable: boolean;
  replaying: boolean;
}

export interface TargetState {
  /** Null hides the target; every new target has a new array. */
  position_m: Point | null;
  /** Null for a point that may be reached in any orientation. */
  orientation: Orientation | null;
  dragging: boolean;
  /** Null until the server has answered for this position. */
  reachable: boolean | null;
  distance_m: number;
  joints_rad: JointValues | null;
}

/** Goal that the user has selected and that is not planned yet; the ghost shows it. */
export interface GoalSelection {
  kind: "none" | "joints" | "target" | "named";
  joints_rad: JointValues | null;
  name?: string;
}

export interface NamedState {
  saved: boolean;
  joints: JointValues;
}

export interface LogEntry {
  stamp: number;
  level: number;
  name: string;
  text: string;
}

export interface ServoState {
  name: string;
  hardware: string;
  level: number;
  message: string;
  values: Record<string, string>;
}

export type ArmHealth = Pick<ServoState, "level" | "message" | "values">;

/** Range that a joint has been moved through, in the ticks of its servo. */
export interface SweptJoint {
  joint: string;
  lowest: number;
  present: number;
  highest: number;
  /** Width that the range of the joint has on an arm as built; 0 where none is known. */
  expected_width: number;
  done: boolean;
  note: string;
  /** Angle by which the joint hangs below its command; NaN while it is not measured. */
  droop_rad: number;
}

export interface Commissioning {
  /** "calibrate" or "verify"; empty while none is in progress. */
  procedure: string;
  step: string;
  instruction: string;
  answers: string[];
  /** Done part of the procedure, 0 to 1. */
  progress: number;
  joints: SweptJoint[];
  findings: string[];
  /** End of the last procedure, as a sentence; empty before. */
  result: string;
}

export interface ActiveGoal {
  id: string;
  name: string;
  state: string;
}

export interface Notice {
  /** Unique: a newer notice with the same key replaces this one. */
  key: string;
  text: string;
}

/** Shape of an object of the planning scene, in its pose within the object. */
export interface Shape {
  kind: "box" | "sphere" | "cylinder" | "cone" | "prism" | "plane" | "mesh";
  position_m: Point;
  orientation: Orientation;
  /** SolidPrimitive.dimensions, or a plane's four coefficients. */
  dimensions: number[];
  /** Corners of a mesh's triangles, or of a prism's polygon. */
  vertices: Point[];
  triangles: [number, number, number][];
}

export interface SceneObject {
  id: string;
  /** Link that the pose is relative to: the root link, or the one that the object is attached to. */
  frame: string;
  attached: boolean;
  position_m: Point;
  orientation: Orientation;
  shapes: Shape[];
  color: Color | null;
  touch_links?: string[];
}

/** Red, green, blue, alpha, 0 to 1. */
export type Color = [number, number, number, number];

export interface NewObject {
  name: string;
  shape: Shape;
}

/** Point of a surface, with the direction away from the surface. */
export interface SurfacePoint {
  point_m: Point;
  normal: Point;
}

export interface SceneChange {
  objects: readonly SceneObject[];
  /** Names of the changed objects; null when the whole scene was replaced. */
  ids: readonly string[] | null;
}

export interface SceneEditing {
  /** Object that the next click in the picture places; null while none is chosen. */
  placing: NewObject | null;
  /** Surface that the user has clicked to place it; null once it is added. */
  clicked: SurfacePoint | null;
  /** Arrows at the selected object: along the axes, or about them. */
  arrows: "translate" | "rotate";
  /** Changes of this page that can be undone, the newest last. */
  history: SceneChange[];
  /** Names of the scenes on the server; null while it has not told them. */
  saved: string[] | null;
  /** Result of the last change, as a sentence; empty after a success that can be seen. */
  result: string;
}

/** Plane through the workspace in which the reach is shown. */
export interface Slice {
  /** "level" lies at a height, "upright" stands on the root link's z axis. */
  kind: "level" | "upright";
  /** Height of a level slice above the root link [m]. */
  height_m: number;
  /** Angle of an upright slice from the x axis [rad]. */
  angle_rad: number;
}

/** Square of a slice with the server's answer: free, in contact with something, or out of reach. */
export interface Cell {
  point_m: Point;
  edge_m: number;
  reach: "free" | "contact" | "out";
}

/** Reachable region of the tip in the present scene. */
export interface Region {
  shown: boolean;
  slice: Slice;
  cells: Cell[];
  total: number;
  /** Reason why nothing is computed, as a sentence; empty without one. */
  problem: string;
}

export interface SequenceState {
  waypoints: readonly Waypoint[];
  /** The server's answer for the leg to each waypoint. */
  checks: LegCheck[];
  /** Waypoint that the arm is on its way to, or at; null while the sequence is not played. */
  playing: { index: number; doing: "check" | Step["doing"] } | null;
  /** Result of the last play, as a sentence; empty before. */
  result: string;
  /** True while the sequence begins again after its last waypoint. */
  loop: boolean;
  /** Sequences that the browser keeps, by name. */
  saved: Record<string, readonly Waypoint[]>;
}

export interface TeachingState {
  /** The recording in progress; null for none. */
  recording: { name: string; duration_s: number } | null;
  /** Names of the motions that the server keeps; null before it has told them. */
  motions: readonly string[] | null;
  edited: { name: string; duration_s: number } | null;
  replaying: string | null;
  /** What the server has said last, a sentence; empty before. */
  told: string;
}

/** Status and parameters of the servo node, which follows the velocities of driving by hand. */
export interface ServoNodeState {
  /** Code of moveit_msgs/ServoStatus: what limits the arm; -1 for a refused command. */
  code: number;
  message: string;
  command_in_type: "unitless" | "speed_units";
  /** Speed of the tip for a command of 1 [m/s]. */
  linear_scale: number;
  /** The same of its rotation [rad/s]. */
  rotational_scale: number;
  /** The same of a joint [rad/s]. */
  joint_scale: number;
}

export interface StudentArm {
  name: string;
  port: number;
  connected: boolean;
  /** Null until its server has told it. */
  arm: ArmState | null;
  seen_rad: JointValues;
}

export interface State {
  link: ConnectionState;
  token: TokenState;
  /** Null until the server has answered. */
  identity: Identity | null;
  control: Control;
  /** Null until /robot_description has come. */
  urdf: string | null;
  /** Joint groups and grippers; null until the server has told them. */
  robot: RobotInfo | null;
  /** Joint group that goals are for, of /moveit_goal_group; empty before the server has told it. */
  group: string;
  joints: Joints;
  limits: Record<string, [number, number]>;
  arm: ArmState;
  goal: GoalState;
  plan: PlanState;
  target: TargetState;
  selection: GoalSelection;
  /** Selection at the start of the present motion. */
  executing_selection: GoalSelection | null;
  named: Record<string, NamedState>;
  objects: SceneObject[];
  log: LogEntry[];
  servos: ServoState[];
  /** Null until the server has reported. */
  arm_health: ArmHealth | null;
  /** Joint whose servo's details are shown; empty for none. */
  selected_servo: string;
  /** Null until the server has told it; a server that offers no procedures never does. */
  commissioning: Commissioning | null;
  /** Joint that is being moved by hand, with the sign of its angle against its servo's ticks; null while none is. */
  joint_in_hand: { joint: string; direction: 1 | -1 } | null;
  active_goals: ActiveGoal[];
  goal_history: GoalEntry[];
  notices: Notice[];
  servo_node: ServoNodeState;
  /** Speed limit of the planning group's arm, of all arms where the group has joints of several. */
  speed_limit: number;
  stop: StopState;
  pending_request: PendingRequest;
  settings: Settings;
  layout: Layout;
  /** Commanded joint positions of the moment; empty while the server publishes none. */
  commanded_rad: JointValues;
  /** True after the first picture of the arm, or where there can be none. */
  drawn: boolean;
  tool_m: Point | null;
  tool_orientation: Orientation | null;
  collision_shapes: boolean;
  /** Id of the selected object of the planning scene, which the user can drag. */
  selected_object: string | null;
  object_colors: Record<string, Color>;
  editing: SceneEditing;
  region: Region;
  sequence: SequenceState;
  /** Pictures of the arm at waypoints, as data URLs by the key of the pose; the view draws them. */
  thumbnails: Record<string, string>;
  teaching: TeachingState;
  /** Arms of the classroom; empty on a server of another kind. */
  classroom: StudentArm[];
}

export const NO_PLAN: PlanState = { trajectory: null, tool_path: [], scrub_s: null, executable: false, replaying: false };

export const NO_GOAL: GoalState = { id: "", source: "", state: "", fraction: 0, seconds_left: null, message: "", code: null, suggestion: null };

export function emptyState(url: string): State {
  return {
    link: { connected: false, latency_ms: null, url, refused: "" },
    token: { held: false, asked: false },
    identity: null,
    control: { holder: "", address: "", policy: "lease", free_in_s: null },
    urdf: null,
    robot: null,
    group: "",
    joints: { names: [], position_rad: [], velocity: [], effort: [], stamp: 0 },
    limits: {},
    arm: {
      mode: "",
      message: "",
      fault: "",
      fault_message: "",
      fault_remedy: "",
      fault_joint: "",
      reason: "",
      task: "",
      speed_factor: 1,
      speed_limit: 1,
      course: "forward",
      last_stop: "",
    },
    goal: NO_GOAL,
    plan: NO_PLAN,
    target: { position_m: null, orientation: null, dragging: false, reachable: null, distance_m: 0, joints_rad: null },
    selection: { kind: "none", joints_rad: null },
    executing_selection: null,
    named: {},
    objects: [],
    log: [],
    servos: [],
    arm_health: null,
    selected_servo: "",
    commissioning: null,
    joint_in_hand: null,
    active_goals: [],
    goal_history: [],
    notices: [],
    speed_limit: 1,
    servo_node: { code: 0, message: "", command_in_type: "unitless", linear_scale: 0.2, rotational_scale: 0.8, joint_scale: 0.5 },
    stop: { phase: "ready", text: "" },
    pending_request: "nothing",
    settings: { units: "deg", speed: 0.3 },
    layout: INITIAL_LAYOUT,
    commanded_rad: {},
    drawn: false,
    tool_m: null,
    tool_orientation: null,
    collision_shapes: false,
    selected_object: null,
    object_colors: {},
    editing: { placing: null, clicked: null, arrows: "translate", history: [], saved: null, result: "" },
    region: { shown: false, slice: { kind: "upright", height_m: 0.1, angle_rad: 0 }, cells: [], total: 0, problem: "" },
    sequence: { waypoints: [], checks: [], playing: null, result: "", loop: false, saved: {} },
    thumbnails: {},
    classroom: [],
    teaching: { recording: null, motions: null, edited: null, replaying: null, told: "" },
  };
}
