/** Everything the page shows, in one place: the link writes it, the panel and the view read it. */

export { emptyState, noGoal } from "./empty";

/** A position in the root link's frame. */
export type Point = [number, number, number];

/** Joint values by joint name, in radians (metres for a joint that slides). */
export type JointValues = Record<string, number>;

/** The connection to the server. */
export interface LinkState {
  connected: boolean;
  /** Round trip of the last question; null before the first answer. */
  latency_ms: number | null;
  url: string;
  /** Why the server does not let the page in, until another token is tried; empty when it does. */
  refused: string;
}

/** Who this page is to the server, from /arm/who_am_i. */
export interface Identity {
  /** IP address and port, which no other client has. */
  address: string;
  role: "view" | "operate" | "admin";
}

/** Who drives the arm, from /arm/control. */
export interface Control {
  /** Empty while nobody does. */
  holder: string;
  address: string;
  /** Whether one client drives at a time, or all may. */
  policy: "lease" | "shared";
  /** When another may drive, if the holder asks for nothing more; null while nobody drives. */
  free_in_s: number | null;
}

/** The token of this page, which itself is kept elsewhere. */
export interface TokenState {
  held: boolean;
  /** Whether the user is asked for one. */
  asked: boolean;
}

/** The newest message of /joint_states. */
export interface Joints {
  names: string[];
  /** Not a number where the message had none. */
  position_rad: number[];
  velocity: number[];
  effort: number[];
  /** When the servos were read, in seconds. */
  stamp: number;
}

/** What /arm/state says of the arm. */
export interface ArmState {
  mode: string;
  /** The server's sentence. */
  message: string;
  /** The code of the fault; empty without one, as the next three. */
  fault: string;
  fault_message: string;
  fault_remedy: string;
  fault_joint: string;
  reason: string;
  speed_factor: number;
  course: string;
}

/** A goal that the server offers in place of one that it refused, ready to be published. */
export interface SuggestedGoal {
  topic: string;
  type: string;
  msg: unknown;
}

/** The goal in hand, or the last one. */
export interface GoalState {
  id: string;
  /** The topic or action that it came by. */
  source: string;
  state: string;
  fraction: number;
  seconds_left: number | null;
  message: string;
  /** MoveIt's error code; null while there is none. */
  code: number | null;
  suggestion: SuggestedGoal | null;
}

/** What became of the last press of STOP. */
export interface StopState {
  phase: "ready" | "asked" | "acknowledged" | "failed";
  text: string;
}

/** What this page itself has asked for and has no answer to. */
export type Asked = "nothing" | "plan" | "move";

/** What the user has chosen for every request of this page. */
export interface Settings {
  units: "deg" | "rad";
  /** Share of the joints' speed limits, above 0 up to 1. */
  speed: number;
}

/** One point of a planned motion. */
export interface PlanPoint {
  time_s: number;
  position_rad: number[];
}

/** A planned motion. */
export interface Plan {
  names: string[];
  points: PlanPoint[];
}

/** The plan that is shown, and where the scrubber stands. */
export interface PlanState {
  trajectory: Plan | null;
  /** Where the tool goes; empty without a plan. The view finds it by the URDF's kinematics. */
  tool_path: Point[];
  /** Null shows the ghost at the end of the plan. */
  scrub_s: number | null;
}

/** The point that the user drags or types. */
export interface TargetState {
  /** Null hides the target. */
  position_m: Point | null;
  dragging: boolean;
  /** Null until the server has answered for this position. */
  reachable: boolean | null;
  distance_m: number;
  /** The nearest configuration that can be reached. */
  joints_rad: JointValues | null;
}

/** What the user asks for before it is planned: the ghost shows it. */
export interface Wish {
  kind: "none" | "joints" | "target" | "named";
  joints_rad: JointValues | null;
  /** Of a named pose. */
  name?: string;
}

/** A named state of the arm. */
export interface NamedState {
  saved: boolean;
  joints: JointValues;
}

/** One entry of the log. */
export interface LogEntry {
  stamp: number;
  level: number;
  name: string;
  text: string;
}

/** One servo, from /diagnostics. */
export interface ServoState {
  name: string;
  level: number;
  message: string;
  values: Record<string, string>;
}

/** A goal that waits for its turn, or is worked on. */
export interface WaitingGoal {
  id: string;
  name: string;
  state: string;
}

/** A message to the user that stays until its cause is gone. */
export interface Notice {
  /** One notice a key: a newer one replaces it. */
  key: string;
  text: string;
}

/** A shape of the planning scene, in the pose it has in its object. */
export interface Shape {
  kind: "box" | "sphere" | "cylinder" | "cone" | "prism" | "plane" | "mesh";
  position_m: Point;
  /** x, y, z, w. */
  orientation: [number, number, number, number];
  /** SolidPrimitive.dimensions, or a plane's four coefficients. */
  dimensions: number[];
  /** A mesh's corners and triangles, or a prism's polygon. */
  vertices: Point[];
  triangles: [number, number, number][];
}

/** A thing of the planning scene. */
export interface SceneObject {
  id: string;
  /** The link that the pose is in: the root link, or the one that holds the thing. */
  frame: string;
  held: boolean;
  position_m: Point;
  orientation: [number, number, number, number];
  shapes: Shape[];
  /** Red, green, blue, alpha, 0 to 1; null takes the theme's colour. */
  color: [number, number, number, number] | null;
}

/** What the page shows. */
export interface State {
  link: LinkState;
  token: TokenState;
  /** Null until the server has told. */
  identity: Identity | null;
  control: Control;
  /** Null until /robot_description has come. */
  urdf: string | null;
  srdf: string | null;
  joints: Joints;
  limits: Record<string, [number, number]>;
  arm: ArmState;
  goal: GoalState;
  plan: PlanState;
  target: TargetState;
  wish: Wish;
  /** What was wished for when the motion in hand began. */
  carried_out: Wish | null;
  named: Record<string, NamedState>;
  objects: SceneObject[];
  log: LogEntry[];
  servos: ServoState[];
  waiting: WaitingGoal[];
  notices: Notice[];
  stop: StopState;
  asked: Asked;
  settings: Settings;
  /** Where the server wants the joints of the arm to be now; empty while it does not say. */
  commanded_rad: JointValues;
  /** Where the tool is drawn; null without an arm. The view writes it. */
  tool_m: Point | null;
  collision_shapes: boolean;
  /** The thing of the planning scene that is chosen, by name; the view lets the user drag it. */
  selected_object: string | null;
}
