import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { selectGoal, Store, type PageStore } from "../state/store";
import type { Connection } from "./connection";
import { MoveGroupClient, startsAtCurrentState } from "./move-group";

const TIME = { sec: 1, nanosec: 0 };
const PLANNED = { joint_trajectory: { joint_names: ["a"], points: [{ positions: [1], time_from_start: TIME }] } };

interface Sent {
  action: string;
  goal: unknown;
  answer: (code: number, message: string) => void;
}

function setUp(): { store: PageStore; moveGroup: MoveGroupClient; sent: Sent[] } {
  const store = new Store(emptyState("ws://here"));
  const sent: Sent[] = [];
  const goal = (action: string, _type: string, sent_goal: unknown): unknown => {
    const result = new Promise((resolve) => {
      const answer = (val: number, message: string): void => {
        const values = { error_code: { val, message }, planned_trajectory: PLANNED };
        resolve({ status: val === 1 ? 4 : 6, values, reason: "" });
      };
      sent.push({ action, goal: sent_goal, answer });
    });
    return { result, cancel: () => undefined };
  };
  return { store, moveGroup: new MoveGroupClient({ goal } as unknown as Connection, store), sent };
}

test("a plan is shown, and Move carries out what the server sent", async () => {
  const { store, moveGroup, sent } = setUp();
  selectGoal(store, "joints", { a: 1 });
  const planning = moveGroup.plan();
  expect(store.state.pending_request).toBe("plan");
  sent[0]?.answer(1, "");
  await planning;
  expect(store.state.plan.trajectory?.points).toEqual([{ time_s: 1, position_rad: [1] }]);
  expect(store.state.pending_request).toBe("nothing");
  void moveGroup.execute();
  expect(sent[1]).toMatchObject({ action: "/execute_trajectory", goal: { trajectory: PLANNED } });
});

test("a refusal is told with its code, and nothing is shown", async () => {
  const { store, moveGroup, sent } = setUp();
  selectGoal(store, "joints", { a: 1 });
  const planning = moveGroup.plan();
  sent[0]?.answer(-12, "a touches b");
  await planning;
  expect(store.state.goal).toMatchObject({ state: "done", code: -12, message: "a touches b" });
  expect(store.state.plan.trajectory).toBeNull();
});

test("a goal that gave way to a newer one says nothing any more", async () => {
  const { store, moveGroup, sent } = setUp();
  selectGoal(store, "joints", { a: 1 });
  const first = moveGroup.planAndExecute();
  const second = moveGroup.planAndExecute();
  sent[0]?.answer(-7, "preempted by goal 2");
  await first;
  expect(store.state.pending_request).toBe("move");
  expect(store.state.goal.code).toBeNull();
  sent[1]?.answer(1, "the arm is there");
  await second;
  expect(store.state.goal.code).toBe(1);
  expect(store.state.pending_request).toBe("nothing");
});

test("without a selection, or a plan, it says what to do first", async () => {
  const { store, moveGroup } = setUp();
  await moveGroup.plan();
  expect(store.state.goal.message).toContain("Choose first");
  await moveGroup.execute();
  expect(store.state.goal.message).toContain("press Plan first");
});

const empty = emptyState("ws://here");
const arm = { ...empty.arm, mode: "holding" };
const plan = {
  names: ["a"],
  points: [
    { time_s: 0, position_rad: [0] },
    { time_s: 1, position_rad: [1] },
  ],
};
const at = (position: number): typeof empty.joints => ({ ...empty.joints, names: ["a"], position_rad: [position] });

test("a plan is shown where it can be carried out, and not after it was", () => {
  expect(startsAtCurrentState(plan, { joints: at(0.01), arm })).toBe(true);
  expect(startsAtCurrentState(plan, { joints: at(0.5), arm })).toBe(false);
  expect(startsAtCurrentState(plan, { joints: at(1), arm })).toBe(false);
  expect(startsAtCurrentState(plan, { joints: at(0), arm: { ...arm, mode: "moving" } })).toBe(false);
  expect(startsAtCurrentState({ ...plan, names: ["unknown"] }, { joints: at(0), arm })).toBe(false);
});
