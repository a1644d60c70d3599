import { withStatus } from "../logic/goal-history";
import { isOpen } from "../logic/layout";
import { NO_GOAL, NO_PLAN, type ActiveGoal, type GoalState, type Identity, type LogEntry, type State } from "../state/state";
import { selectGroup, setNotice, type PageStore } from "../state/store";
import { WHILE_CONNECTED_S, type Connection } from "./connection";
import {
  PREEMPTED,
  readArmHealth,
  readArmState,
  readControl,
  readGoal,
  readJoints,
  readLimits,
  readLogEntry,
  readServos,
  SUCCESS,
  valuesByJoint,
  type TriggerResponse,
} from "./messages";
import { PAGE_VERSION, versionMismatch } from "../logic/version";
import { applyColors, applyPlanningScene, drawableObjects } from "./planning-scene";

/** Least time between two messages that are drawn [ms]: 30 per second look smooth. */
const REDRAW_PERIOD_MS = 33;

const MAX_LOG_ENTRIES = 500;

export function subscribeTopics(connection: Connection, store: PageStore): void {
  subscribeRobot(connection, store);
  connection.subscribe("/joint_states", "sensor_msgs/msg/JointState", (message) => store.set({ joints: readJoints(message) }), REDRAW_PERIOD_MS);
  connection.subscribe("/moveit_goal_status", "diagnostic_msgs/msg/DiagnosticStatus", (status) => {
    const goal = readGoal(status);
    const goal_history = withStatus(store.state.goal_history, goal, Date.now() / 1000);
    store.set({ ...applyGoalStatus(store.state, goal), goal_history });
  });
  connection.subscribe("/rosout", "rcl_interfaces/msg/Log", (message) => {
    store.set({ log: withLogEntry(store.state.log, readLogEntry(message)) });
  });
  connection.subscribe("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", ({ status }) => {
    store.set({ servos: readServos(status), arm_health: readArmHealth(status) });
  });
  connection.subscribe("/monitored_planning_scene", "moveit_msgs/msg/PlanningScene", (scene) => {
    const object_colors = applyColors(store.state.object_colors, scene);
    const { objects, problems } = drawableObjects(applyPlanningScene(store.state.objects, scene, object_colors));
    store.set({ objects, object_colors });
    setNotice(store, "scene", problems.join(" "));
  });
}

/** Return the log with an entry; the server sends its last ones again to a page that has come back. */
export function withLogEntry(log: readonly LogEntry[], entry: LogEntry): LogEntry[] {
  const is_known = log.some(({ stamp, name, text }) => stamp === entry.stamp && name === entry.name && text === entry.text);
  return is_known ? [...log] : [...log.slice(1 - MAX_LOG_ENTRIES), entry];
}

function subscribeRobot(connection: Connection, store: PageStore): void {
  connection.subscribe("/robot_description", "std_msgs/msg/String", ({ data }) => store.set({ urdf: data }));
  connection.subscribe("/armbridge/robot", "std_msgs/msg/String", ({ data }) => {
    store.set({ robot: JSON.parse(data) as State["robot"] });
  });
  connection.subscribe("/moveit_goal_group", "std_msgs/msg/String", ({ data }) => selectGroup(store, data));
  connection.subscribe("/arm/joint_limits", "moveit_msgs/msg/KinematicSolverInfo", (message) => {
    store.set({ limits: readLimits(message) });
  });
  connection.subscribe("/named_states", "std_msgs/msg/String", ({ data }) => {
    store.set({ named: JSON.parse(data) as State["named"] });
  });
  connection.subscribe("/arm/state", "diagnostic_msgs/msg/DiagnosticStatus", (status) => {
    store.set({ arm: readArmState(status) });
  });
}

/** Have the commanded positions while the arm moves, or a panel needs them: at rest they would cost the server as much as all else. */
export function followCommands(connection: Connection, store: PageStore): void {
  const type = "control_msgs/msg/JointTrajectoryControllerState";
  const ends: (() => void)[] = [];
  const wanted = ({ link, arm, layout }: State): boolean =>
    link.connected && (arm.mode === "moving" || isOpen(layout, "drive") || isOpen(layout, "plots"));
  const begin = async (): Promise<void> => {
    const { topics } = await connection.call<{ topics: string[] }>("/rosapi/topics_for_type", { type }, WHILE_CONNECTED_S);
    if (!wanted(store.state) || ends.length > 0) return;
    // Each controller has its state under an old and a new name.
    const new_names = topics.filter((name) => name.endsWith("/controller_state"));
    ends.push(...new_names.map((topic) => connection.subscribe(topic, type, ({ joint_names, reference }) => {
      store.set({ commanded_rad: { ...store.state.commanded_rad, ...valuesByJoint(joint_names, reference.positions) } });
    }, REDRAW_PERIOD_MS, 0)));
  };
  store.subscribe(wanted, (is_wanted) => {
    for (const end of ends.splice(0)) end();
    store.set({ commanded_rad: {} });
    if (is_wanted) begin().catch(() => undefined);
  });
}

/** Forget goals that may have ended while the page was disconnected. */
export function resetAfterReconnect(store: PageStore): void {
  const in_progress = ["queued", "planning", "executing"].includes(store.state.goal.state);
  // Another server knows nothing of the plan; the same one sends its last plan again.
  store.set({ active_goals: [], goal: in_progress ? NO_GOAL : store.state.goal, plan: NO_PLAN });
  setNotice(store, "link", "");
}

/** Return the changes of the state after a status of a goal: the goal that is shown, and all active goals. */
export function applyGoalStatus(state: State, goal: GoalState): Partial<State> {
  const done = goal.state === "done";
  const active_goals = withActiveGoal(state.active_goals, goal);
  const in_progress = state.active_goals.some(({ id, state: stage }) => id === state.goal.id && stage !== "queued");
  // A goal that joins or leaves the queue must not hide the one that moves the arm.
  const is_queued = in_progress && goal.id !== state.goal.id && (goal.state === "queued" || done);
  const was_preempted = done && goal.code === PREEMPTED && active_goals.length > 0;
  if (is_queued || was_preempted) return { active_goals };
  const begins = goal.state === "executing" && !(state.goal.id === goal.id && state.goal.state === "executing");
  if (!done) return { active_goals, goal, ...(begins && { executing_selection: state.selection }) };
  if (goal.code === SUCCESS) return { active_goals, goal, ...clearSelection(state) };
  // The arm stands somewhere on the path, and the plan does not start there.
  return { active_goals, goal, ...(state.goal.id === goal.id && state.goal.state === "executing" && { plan: NO_PLAN }) };
}

/** Return the active goals after a status of one, each in its place; the same list when nothing of it has changed. */
function withActiveGoal(goals: ActiveGoal[], { id, source: name, state }: GoalState): ActiveGoal[] {
  if (state === "done") return goals.some((goal) => goal.id === id) ? goals.filter((goal) => goal.id !== id) : goals;
  const known = goals.find((goal) => goal.id === id);
  if (known === undefined) return [...goals, { id, name, state }];
  return known.state === state ? goals : goals.map((goal) => (goal === known ? { id, name, state } : goal));
}

/** Clear the selection that a motion has reached; one that the user has made meanwhile stays. */
function clearSelection(state: State): Partial<State> {
  if (state.target.dragging || state.selection !== state.executing_selection) return {};
  return { selection: { kind: "none", joints_rad: null }, plan: NO_PLAN };
}

export function subscribeControl(connection: Connection, store: PageStore): void {
  connection.subscribe("/arm/control", "diagnostic_msgs/msg/DiagnosticStatus", (status) => {
    store.set({ control: readControl(status) });
  });
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      // The identity contains the port of the connection, which changes with each one.
      store.set({ identity: null });
      if (connected) void fetchIdentity(connection, store);
    },
  );
}

async function fetchIdentity(connection: Connection, store: PageStore): Promise<void> {
  try {
    const { message } = await connection.call<TriggerResponse>("/arm/who_am_i", {}, WHILE_CONNECTED_S);
    const identity = JSON.parse(message) as Identity;
    store.set({ identity });
    setNotice(store, "version", versionMismatch(identity.version, PAGE_VERSION));
  } catch {
    // Without an identity every control stays enabled; the server itself rejects forbidden requests.
  }
}
