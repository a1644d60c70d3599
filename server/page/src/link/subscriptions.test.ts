import { expect, test } from "vitest";
import { emptyState, NO_GOAL, type GoalState, type State } from "../state/state";
import { Store, type PageStore } from "../state/store";
import type { Connection } from "./connection";
import type { DiagnosticStatus } from "./messages";
import { applyGoalStatus, followCommands, resetAfterReconnect, subscribeControl, subscribeTopics, withLogEntry } from "./subscriptions";

const empty = emptyState("ws://here");
const news = (id: string, state: string, patch: Partial<GoalState> = {}): GoalState => ({ ...NO_GOAL, id, state, ...patch });

test("a goal that waits does not hide the one in hand, and is shown once it is worked on", () => {
  let state = { ...empty, ...applyGoalStatus(empty, news("1", "executing")) };
  state = { ...state, ...applyGoalStatus(state, news("2", "queued")) };
  expect(state.goal.id).toBe("1");
  expect(state.active_goals.map(({ id }) => id)).toEqual(["1", "2"]);
  state = { ...state, ...applyGoalStatus(state, news("1", "done", { code: 1 })) };
  state = { ...state, ...applyGoalStatus(state, news("2", "planning")) };
  expect(state.goal.id).toBe("2");
  expect(state.active_goals).toEqual([{ id: "2", name: "", state: "planning" }]);
});

test("a goal that gave way to the next is not shown as stopped", () => {
  let state = { ...empty, ...applyGoalStatus(empty, news("1", "executing")) };
  state = { ...state, ...applyGoalStatus(state, news("2", "queued")) };
  state = { ...state, ...applyGoalStatus(state, news("1", "done", { code: -7 })) };
  expect(state.goal.state).toBe("executing");
  state = { ...state, ...applyGoalStatus(state, news("2", "done", { code: -7 })) };
  expect(state.goal).toMatchObject({ id: "2", state: "done", code: -7 });
});

test("a goal that was refused while it waited leaves the one in hand", () => {
  let state = { ...empty, ...applyGoalStatus(empty, news("1", "executing")) };
  state = { ...state, ...applyGoalStatus(state, news("2", "done", { code: -16 })) };
  expect(state.goal.id).toBe("1");
});

test("after a stop on the way the plan is gone, and the selection stays", () => {
  const trajectory = { names: ["a"], points: [] };
  const selection = { kind: "joints" as const, joints_rad: { a: 1 } };
  const moving = { ...empty, selection, plan: { ...empty.plan, trajectory }, goal: news("1", "executing") };
  const after = { ...moving, ...applyGoalStatus(moving, news("1", "done", { code: -7 })) };
  expect(after.plan.trajectory).toBeNull();
  expect(after.selection).toBe(selection);
});

test("after an arrival nothing is wished for, after a refusal the selection stays", () => {
  const wishing = { ...empty, selection: { kind: "joints" as const, joints_rad: { a: 1 } } };
  const moving = { ...wishing, ...applyGoalStatus(wishing, news("1", "executing")) };
  expect(applyGoalStatus(moving, news("1", "done", { code: 1 })).selection?.kind).toBe("none");
  expect(applyGoalStatus(moving, news("1", "done", { code: -12 })).selection).toBeUndefined();
});

test("a goal selected while the arm moves stays selected when it arrives", () => {
  let state: State = { ...empty, selection: { kind: "joints", joints_rad: { a: 1 } } };
  state = { ...state, ...applyGoalStatus(state, news("1", "executing")), selection: { kind: "joints", joints_rad: { a: 2 } } };
  state = { ...state, ...applyGoalStatus(state, news("1", "executing", { fraction: 0.9 })) };
  expect(applyGoalStatus(state, news("1", "done", { code: 1 })).selection).toBeUndefined();
});

const ME = JSON.stringify({ name: "alice (10.0.0.1:5)", address: "10.0.0.1:5", role: "operate", version: "" });

function heard(call: () => Promise<unknown>): { store: PageStore; tell: (status: DiagnosticStatus) => void } {
  const store = new Store(emptyState("ws://here"));
  let tell: (status: DiagnosticStatus) => void = () => undefined;
  const subscribe = (_topic: string, _type: string, listener: typeof tell): void => void (tell = listener);
  subscribeControl({ subscribe, call } as unknown as Connection, store);
  return { store, tell: (status) => tell(status) };
}

test("the page learns who it is, and forgets it with the connection", async () => {
  const { store } = heard(() => Promise.resolve({ success: true, message: ME }));
  store.patch("link", { connected: true });
  await Promise.resolve();
  expect(store.state.identity).toMatchObject({ address: "10.0.0.1:5", role: "operate", version: "" });
  store.patch("link", { connected: false });
  expect(store.state.identity).toBeNull();
});

test("a server that does not tell leaves it unknown", async () => {
  const { store } = heard(() => Promise.reject(new Error("no such service")));
  store.patch("link", { connected: true });
  await Promise.resolve();
  expect(store.state.identity).toBeNull();
});

test("a message of /arm/control is shown", () => {
  const { store, tell } = heard(() => Promise.reject(new Error("nobody")));
  const values = [{ key: "address", value: "10.0.0.1:6" }, { key: "policy", value: "lease" }, { key: "free_in_s", value: "7" }];
  tell({ level: 0, name: "control", message: "", hardware_id: "bob", values });
  expect(store.state.control).toEqual({ holder: "bob", address: "10.0.0.1:6", policy: "lease", free_in_s: 7 });
});

/** Connection that keeps the listeners of topics and answers calls. */
function listening(answers: Record<string, unknown>): { connection: Connection; tell: (topic: string, message: unknown) => void; heard: () => string[] } {
  const listeners = new Map<string, (message: unknown) => void>();
  const connection = {
    subscribe: (topic: string, _type: string, listener: (message: unknown) => void) => {
      listeners.set(topic, listener);
      return () => listeners.delete(topic);
    },
    call: (service: string) => Promise.resolve(answers[service]),
  } as unknown as Connection;
  return { connection, tell: (topic, message) => listeners.get(topic)?.(message), heard: () => [...listeners.keys()] };
}

test("commanded positions come from the controllers of all groups while the arm moves or they are shown", async () => {
  const blank = emptyState("ws://here");
  const store = new Store<State>({ ...blank, link: { ...blank.link, connected: true } });
  const topics = ["/arm_controller/state", "/arm_controller/controller_state", "/lift_controller/controller_state"];
  const { connection, tell, heard } = listening({ "/rosapi/topics_for_type": { topics } });
  followCommands(connection, store);
  await Promise.resolve();
  expect(heard()).toEqual([]);
  for (const use of [{ arm: { ...blank.arm, mode: "moving" } }, { layout: { shown: "plots", pinned: "" } }, { layout: { shown: "", pinned: "drive" } }]) {
    store.set(use);
    await Promise.resolve();
    expect(heard()).toEqual(topics.slice(1));
    tell("/arm_controller/controller_state", { joint_names: ["a"], reference: { positions: [1] } });
    tell("/lift_controller/controller_state", { joint_names: ["b"], reference: { positions: [2] } });
    expect(store.state.commanded_rad).toEqual({ a: 1, b: 2 });
    store.set({ arm: blank.arm, layout: blank.layout });
    expect([heard(), store.state.commanded_rad]).toEqual([[], {}]);
  }
  store.set({ layout: { shown: "drive", pinned: "" } });
  store.set({ layout: blank.layout });
  await Promise.resolve();
  expect(heard()).toEqual([]);
});

test("after a break of the connection no plan is offered, and no goal is in progress", () => {
  const blank = emptyState("ws://here");
  const plan = { ...blank.plan, trajectory: { names: ["a"], points: [] } };
  const store = new Store<State>({ ...blank, plan, goal: news("1", "executing"), active_goals: [{ id: "1", name: "", state: "executing" }] });
  resetAfterReconnect(store);
  expect(store.state).toMatchObject({ plan: { trajectory: null }, active_goals: [], goal: { id: "", state: "" } });
});

test("the group of the server is that of the page, and telling it again keeps what the user has selected", () => {
  const store = new Store(emptyState("ws://here"));
  const { connection, tell } = listening({});
  subscribeTopics(connection, store);
  tell("/moveit_goal_group", { data: "left" });
  expect(store.state.group).toBe("left");
  store.set({ selection: { kind: "joints", joints_rad: { a: 1 } } });
  tell("/moveit_goal_group", { data: "left" });
  expect(store.state.selection.kind).toBe("joints");
});

test("a log line that the server sends again after a break of the connection is shown once", () => {
  const line = (stamp: number): State["log"][number] => ({ stamp, level: 20, name: "armbridge", text: "ready" });
  const log = [line(1), line(2)];
  expect(withLogEntry(log, line(2))).toEqual(log);
  expect(withLogEntry(log, line(3))).toEqual([...log, line(3)]);
});
