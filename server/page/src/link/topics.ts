import { PREEMPTED, SUCCESS } from "../logic/codes";
import { drawable } from "../logic/drawable";
import { setNotice } from "../state/notices";
import { noGoal, type GoalState, type State } from "../state/state";
import type { Store } from "../state/store";
import type { Link } from "./link";
import * as parsing from "./parsing";
import { sceneObjects } from "./scene";
import type {
  ControllerState,
  DiagnosticStatus,
  JointState,
  KinematicSolverInfo,
  Log,
  PlanningScene,
  Text,
} from "./wire";

/** Least time between two messages that are drawn [ms]: 30 a second look smooth. */
const DRAWN_MS = 33;

const NO_PLAN: State["plan"] = { trajectory: null, tool_path: [], scrub_s: null };

/** How many entries of the log are kept. */
const LOG_ENTRIES = 500;

/** Hear every topic that the page shows. */
export function hearTopics(link: Link, store: Store<State>): void {
  hearRobot(link, store);
  hearMotion(link, store);
  link.subscribe<DiagnosticStatus>("/moveit_goal_status", "diagnostic_msgs/DiagnosticStatus", (status) => {
    store.set(afterGoalNews(store.state, parsing.goal(status)));
  });
  link.subscribe<Log>("/rosout", "rcl_interfaces/Log", (message) => {
    store.set({ log: [...store.state.log.slice(1 - LOG_ENTRIES), parsing.logEntry(message)] });
  });
  link.subscribe<{ status: DiagnosticStatus[] }>("/diagnostics", "diagnostic_msgs/DiagnosticArray", ({ status }) => {
    store.set({ servos: parsing.servos(status) });
  });
  link.subscribe<PlanningScene>("/monitored_planning_scene", "moveit_msgs/PlanningScene", (scene) => {
    const { objects, problems } = drawable(sceneObjects(store.state.objects, scene));
    store.set({ objects });
    setNotice(store, "scene", problems.join(" "));
  });
}

function hearRobot(link: Link, store: Store<State>): void {
  link.subscribe<Text>("/robot_description", "std_msgs/String", ({ data }) => store.set({ urdf: data }));
  link.subscribe<Text>("/robot_description_semantic", "std_msgs/String", ({ data }) => store.set({ srdf: data }));
  link.subscribe<KinematicSolverInfo>("/arm/joint_limits", "moveit_msgs/KinematicSolverInfo", (message) => {
    store.set({ limits: parsing.limits(message) });
  });
  link.subscribe<Text>("/named_states", "std_msgs/String", ({ data }) => store.set({ named: parsing.named(data) }));
  link.subscribe<DiagnosticStatus>("/arm/state", "diagnostic_msgs/DiagnosticStatus", (status) => {
    store.set({ arm: parsing.arm(status) });
  });
}

function hearMotion(link: Link, store: Store<State>): void {
  const joints = (message: JointState): void => store.set({ joints: parsing.joints(message) });
  link.subscribe<JointState>("/joint_states", "sensor_msgs/JointState", joints, DRAWN_MS);
}

/** Hear where the server wants the joints to be; it says so on the topics of the arm's controller. */
export async function hearController(link: Link, store: Store<State>, known: Set<string>): Promise<void> {
  const type = "control_msgs/msg/JointTrajectoryControllerState";
  const { topics } = await link.call<{ topics: string[] }>("/rosapi/topics_for_type", { type });
  const topic = topics.find((name) => name.endsWith("/controller_state")) ?? topics[0];
  if (topic === undefined || known.has(topic)) return;
  known.add(topic);
  const hear = ({ joint_names, reference }: ControllerState): void => {
    store.set({ commanded_rad: parsing.byName(joint_names, reference.positions) });
  };
  link.subscribe<ControllerState>(topic, type, hear, DRAWN_MS);
}

/** Forget what may have ended while nobody listened. */
export function startAnew(store: Store<State>): void {
  const inHand = ["queued", "planning", "executing"].includes(store.state.goal.state);
  store.set({ waiting: [], commanded_rad: {}, goal: inHand ? noGoal() : store.state.goal });
  setNotice(store, "link", "");
}

/** What is shown after the news of a goal: the goal in hand, and those that wait. */
export function afterGoalNews(state: State, goal: GoalState): Partial<State> {
  const others = state.waiting.filter(({ id }) => id !== goal.id);
  const done = goal.state === "done";
  const waiting = done ? others : [...others, { id: goal.id, name: goal.source, state: goal.state }];
  const inHand = state.waiting.some(({ id, state: its }) => id === state.goal.id && its !== "queued");
  // One that joins the queue, or leaves it, must not hide the one that moves the arm.
  const behind = inHand && goal.id !== state.goal.id && (goal.state === "queued" || done);
  const gaveWay = done && goal.code === PREEMPTED && waiting.length > 0;
  if (behind || gaveWay) return { waiting };
  const begins = goal.state === "executing" && !(state.goal.id === goal.id && state.goal.state === "executing");
  if (!done) return { waiting, goal, ...(begins && { carried_out: state.wish }) };
  if (goal.code === SUCCESS) return { waiting, goal, ...nothingWished(state) };
  // The arm stands somewhere on the way: the plan does not begin there.
  const onTheWay = state.goal.id === goal.id && state.goal.state === "executing";
  return onTheWay ? { waiting, goal, plan: NO_PLAN } : { waiting, goal };
}

/** After a motion what was wished for is where the arm is; what the user has chosen meanwhile stays. */
function nothingWished(state: State): Partial<State> {
  if (state.target.dragging || state.wish !== state.carried_out) return {};
  return { wish: { kind: "none", joints_rad: null }, plan: NO_PLAN };
}
