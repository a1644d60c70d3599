import { expect, test } from "vitest";
import { emptyState, noGoal, type GoalState, type State } from "../state/state";
import { afterGoalNews } from "./topics";

const empty = emptyState("ws://here");
const news = (id: string, state: string, patch: Partial<GoalState> = {}): GoalState => ({ ...noGoal(), id, state, ...patch });

test("a goal that waits does not hide the one in hand, and is shown once it is worked on", () => {
  let state = { ...empty, ...afterGoalNews(empty, news("1", "executing")) };
  state = { ...state, ...afterGoalNews(state, news("2", "queued")) };
  expect(state.goal.id).toBe("1");
  expect(state.waiting.map(({ id }) => id)).toEqual(["1", "2"]);
  state = { ...state, ...afterGoalNews(state, news("1", "done", { code: 1 })) };
  state = { ...state, ...afterGoalNews(state, news("2", "planning")) };
  expect(state.goal.id).toBe("2");
  expect(state.waiting).toEqual([{ id: "2", name: "", state: "planning" }]);
});

test("a goal that gave way to the next is not shown as stopped", () => {
  let state = { ...empty, ...afterGoalNews(empty, news("1", "executing")) };
  state = { ...state, ...afterGoalNews(state, news("2", "queued")) };
  state = { ...state, ...afterGoalNews(state, news("1", "done", { code: -7 })) };
  expect(state.goal.state).toBe("executing");
  state = { ...state, ...afterGoalNews(state, news("2", "done", { code: -7 })) };
  expect(state.goal).toMatchObject({ id: "2", state: "done", code: -7 });
});

test("a goal that was refused while it waited leaves the one in hand", () => {
  let state = { ...empty, ...afterGoalNews(empty, news("1", "executing")) };
  state = { ...state, ...afterGoalNews(state, news("2", "done", { code: -16 })) };
  expect(state.goal.id).toBe("1");
});

test("after a stop on the way the plan is gone, and the wish stays", () => {
  const trajectory = { names: ["a"], points: [] };
  const wish = { kind: "joints" as const, joints_rad: { a: 1 } };
  const moving = { ...empty, wish, plan: { ...empty.plan, trajectory }, goal: news("1", "executing") };
  const after = { ...moving, ...afterGoalNews(moving, news("1", "done", { code: -7 })) };
  expect(after.plan.trajectory).toBeNull();
  expect(after.wish).toBe(wish);
});

test("after an arrival nothing is wished for, after a refusal the wish stays", () => {
  const wishing = { ...empty, wish: { kind: "joints" as const, joints_rad: { a: 1 } } };
  const moving = { ...wishing, ...afterGoalNews(wishing, news("1", "executing")) };
  expect(afterGoalNews(moving, news("1", "done", { code: 1 })).wish?.kind).toBe("none");
  expect(afterGoalNews(moving, news("1", "done", { code: -12 })).wish).toBeUndefined();
});

test("what is chosen while the arm moves is still chosen when it arrives", () => {
  let state: State = { ...empty, wish: { kind: "joints", joints_rad: { a: 1 } } };
  state = { ...state, ...afterGoalNews(state, news("1", "executing")), wish: { kind: "joints", joints_rad: { a: 2 } } };
  state = { ...state, ...afterGoalNews(state, news("1", "executing", { fraction: 0.9 })) };
  expect(afterGoalNews(state, news("1", "done", { code: 1 })).wish).toBeUndefined();
});
