// Everything that the page shows: link/ and the user's input write it, panel/ and view/ read it.

/** Position in the root link's frame. */
export type Point = [number, number, number];

/** Orientation in the root link's frame, as a unit quaternion: x, y, z, w. */
export type Orientation = [number, number, number, number];

/** Joint values by joint name, in radians (metres for a joint that slides). */
export type JointValues = Record<string, number>;

/** Condition of the connection to the server. */
export interface ConnectionState {
  connected: boolean;
  /** Round-trip time of the last heartbeat; null before the first answer. */
  latency_ms: number | null;
  url: string;
  /** Server's reason for rejecting the page, until another token is tried; empty when it accepts it. */
  refused: string;
}

/** Identity of this page among the server's clients, from /arm/who_am_i. */
export interface Identity {
  /** IP address and port of the connection, which are unique to it. */
  address: string;
  role: "view" | "operate" | "admin";
}

/** Control of the arm, from /arm/control. */
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
  /** True while the user is asked for a token. */
  asked: boolean;
}

/** Newest message of /joint_states. */
export interface Joints {
  names: string[];
  /** NaN where the message had no number. */
  position_rad: number[];
  velocity: number[];
  effort: number[];
  /** Time at which the servos were read, in seconds. */
  stamp: number;
}

/** Newest message of /arm/state. */
export interface ArmState {
  mode: string;
  /** Sentence of the server. */
  message: string;
  /** Code of the fault; empty without one, as are the next three. */
  fault: string;
  fault_message: string;
  fault_remedy: string;
  fault_joint: string;
  reason: string;
  speed_factor: number;
  course: string;
}

/** Goal that the server suggests in place of one that it rejected, ready to be published. */
export interface SuggestedGoal {
  topic: string;
  type: string;
  msg: unknown;
}

/** Present goal, or the last one. */
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

/** Answer to the last press of STOP. */
export interface StopState {
  phase: "ready" | "asked" | "acknowledged" | "failed";
  text: string;
}

/** Request of this page that has no answer yet. */
export type PendingRequest = "nothing" | "plan" | "move";

/** Settings of the user that apply to every request of this page. */
export interface Settings {
  units: "deg" | "rad";
  /** Fraction of the joints' speed limits, above 0 and up to 1. */
  speed: number;
}

/** Point of a planned trajectory. */
export interface PlanPoint {
  time_s: number;
  position_rad: number[];
}

/** Planned trajectory. */
export interface Plan {
  names: string[];
  points: PlanPoint[];
}

/** Plan that is shown, and the position of the scrubber. */
export interface PlanState {
  trajectory: Plan | null;
  /** Path of the tool, which the view computes from the URDF; empty without a plan. */
  tool_path: Point[];
  /** Time on the plan at which the ghost is shown; null means the end. */
  scrub_s: number | null;
}

/** Target of the tool, which the user drags or types. */
export interface TargetState {
  /** Null hides the target; every new target has a new array. */
  position_m: Point | null;
  /** Null for a point that may be reached in any orientation. */
  orientation: Orientation | null;
  dragging: boolean;
  /** Null until the server has answered for this position. */
  reachable: boolean | null;
  distance_m: number;
  /** Joint values of the nearest reachable point. */
  joints_rad: JointValues | null;
}

/** Goal that the user has selected and that is not planned yet; the ghost shows it. */
export interface GoalSelection {
  kind: "none" | "joints" | "target" | "named";
  joints_rad: JointValues | null;
  /** Name of a named pose. */
  name?: string;
}

/** Named state of the arm. */
export interface NamedState {
  saved: boolean;
  joints: JointValues;
}

/** Entry of the log. */
export interface LogEntry {
  stamp: number;
  level: number;
  name: string;
  text: string;
}

/** Condition of a servo, from /diagnostics. */
export interface ServoState {
  name: string;
  level: number;
  message: string;
  values: Record<string, string>;
}

/** Goal that is queued, planned or executed. */
export interface ActiveGoal {
  id: string;
  name: string;
  state: string;
}

/** Message to the user that stays until its cause is gone. */
export interface Notice {
  /** Unique: a newer notice with the same key replaces this one. */
  key: string;
  text: string;
}

/** Shape of an object of the planning scene, in its pose within the object. */
export interface Shape {
  kind: "box" | "sphere" | "cylinder" | "cone" | "prism" | "plane" | "mesh";
  position_m: Point;
  /** x, y, z, w. */
  orientation: Orientation;
  /** SolidPrimitive.dimensions, or a plane's four coefficients. */
  dimensions: number[];
  /** Corners of a mesh's triangles, or of a prism's polygon. */
  vertices: Point[];
  triangles: [number, number, number][];
}

/** Object of the planning scene. */
export interface SceneObject {
  id: string;
  /** Link that the pose is relative to: the root link, or the one that the object is attached to. */
  frame: string;
  attached: boolean;
  position_m: Point;
  orientation: Orientation;
  shapes: Shape[];
  /** Red, green, blue, alpha, 0 to 1; null takes the theme's colour. */
  color: [number, number, number, number] | null;
}

/** State of the page. */
export interface State {
  link: ConnectionState;
  token: TokenState;
  /** Null until the server has answered. */
  identity: Identity | null;
  control: Control;
  /** Null until /robot_description has come. */
  urdf: string | null;
  srdf: string | null;
  /** Joint group that goals are for, of /moveit_goal_group; empty before the server has told it. */
  group: string;
  /** Actions that the server offers; null before it has told them. */
  actions: string[] | null;
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
  active_goals: ActiveGoal[];
  notices: Notice[];
  stop: StopState;
  pending_request: PendingRequest;
  settings: Settings;
  /** Commanded joint positions of the moment; empty while the server publishes none. */
  commanded_rad: JointValues;
  /** Position of the drawn tool, which the view computes; null without an arm. */
  tool_m: Point | null;
  /** Orientation of the drawn tool; null without an arm. */
  tool_orientation: Orientation | null;
  collision_shapes: boolean;
  /** Id of the selected object of the planning scene, which the user can drag. */
  selected_object: string | null;
}

/** Return the state before the first message. */
export function emptyState(url: string): State {
  return {
    link: { connected: false, latency_ms: null, url, refused: "" },
    token: { held: false, asked: false },
    identity: null,
    control: { holder: "", address: "", policy: "lease", free_in_s: null },
    urdf: null,
    srdf: null,
    group: "",
    actions: null,
    joints: { names: [], position_rad: [], velocity: [], effort: [], stamp: 0 },
    limits: {},
    arm: noArm(),
    goal: noGoal(),
    plan: { trajectory: null, tool_path: [], scrub_s: null },
    target: { position_m: null, orientation: null, dragging: false, reachable: null, distance_m: 0, joints_rad: null },
    selection: { kind: "none", joints_rad: null },
    executing_selection: null,
    named: {},
    objects: [],
    log: [],
    servos: [],
    active_goals: [],
    notices: [],
    stop: { phase: "ready", text: "" },
    pending_request: "nothing",
    settings: { units: "deg", speed: 0.3 },
    commanded_rad: {},
    tool_m: null,
    tool_orientation: null,
    collision_shapes: false,
    selected_object: null,
  };
}

/** Return the goal state before the first goal. */
export function noGoal(): GoalState {
  return {
    id: "",
    source: "",
    state: "",
    fraction: 0,
    seconds_left: null,
    message: "",
    code: null,
    suggestion: null,
  };
}

function noArm(): ArmState {
  return {
    mode: "disconnected",
    message: "",
    fault: "",
    fault_message: "",
    fault_remedy: "",
    fault_joint: "",
    reason: "",
    speed_factor: 1,
    course: "forward",
  };
}
