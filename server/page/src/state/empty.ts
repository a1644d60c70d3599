import type { ArmState, GoalState, State } from "./state";

/** What the page shows before the first message. */
export function emptyState(url: string): State {
  return {
    link: { connected: false, latency_ms: null, url, refused: "" },
    token: { held: false, asked: false },
    identity: null,
    control: { holder: "", address: "", policy: "lease", free_in_s: null },
    urdf: null,
    srdf: null,
    joints: { names: [], position_rad: [], velocity: [], effort: [], stamp: 0 },
    limits: {},
    arm: noArm(),
    goal: noGoal(),
    plan: { trajectory: null, tool_path: [], scrub_s: null },
    target: { position_m: null, dragging: false, reachable: null, distance_m: 0, joints_rad: null },
    wish: { kind: "none", joints_rad: null },
    carried_out: null,
    named: {},
    objects: [],
    log: [],
    servos: [],
    waiting: [],
    notices: [],
    stop: { phase: "ready", text: "" },
    asked: "nothing",
    settings: { units: "deg", speed: 0.3 },
    commanded_rad: {},
    tool_m: null,
    collision_shapes: false,
    selected_object: null,
  };
}

/** Before the first goal. */
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
