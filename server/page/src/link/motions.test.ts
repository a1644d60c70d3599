import { expect, test } from "vitest";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { wish } from "../state/wishes";
import type { Link } from "./link";
import { Motions } from "./motions";
import type { MotionResult } from "./wire";

const TIME = { sec: 1, nanosec: 0 };
const PLANNED = { joint_trajectory: { joint_names: ["a"], points: [{ positions: [1], time_from_start: TIME }] } };

interface Sent {
  action: string;
  goal: unknown;
  answer: (code: number, message: string) => void;
}

function desk(): { store: Store<State>; motions: Motions; sent: Sent[] } {
  const store = new Store(emptyState("ws://here"));
  const sent: Sent[] = [];
  const goal = (action: string, _type: string, asked: unknown): unknown => {
    const result = new Promise((resolve) => {
      const answer = (val: number, message: string): void => {
        const values: MotionResult = { error_code: { val, message }, planned_trajectory: PLANNED };
        resolve({ status: val === 1 ? 4 : 6, values, reason: "" });
      };
      sent.push({ action, goal: asked, answer });
    });
    return { result, cancel: () => undefined };
  };
  return { store, motions: new Motions({ goal } as unknown as Link, store), sent };
}

test("a plan is shown, and Move carries out what the server sent", async () => {
  const { store, motions, sent } = desk();
  wish(store, "joints", { a: 1 });
  const planning = motions.plan();
  expect(store.state.asked).toBe("plan");
  sent[0]?.answer(1, "");
  await planning;
  expect(store.state.plan.trajectory?.points).toEqual([{ time_s: 1, position_rad: [1] }]);
  expect(store.state.asked).toBe("nothing");
  void motions.move();
  expect(sent[1]).toMatchObject({ action: "/execute_trajectory", goal: { trajectory: PLANNED } });
});

test("a refusal is told with its code, and nothing is shown", async () => {
  const { store, motions, sent } = desk();
  wish(store, "joints", { a: 1 });
  const planning = motions.plan();
  sent[0]?.answer(-12, "a touches b");
  await planning;
  expect(store.state.goal).toMatchObject({ state: "done", code: -12, message: "a touches b" });
  expect(store.state.plan.trajectory).toBeNull();
});

test("a goal that gave way to a newer one says nothing any more", async () => {
  const { store, motions, sent } = desk();
  wish(store, "joints", { a: 1 });
  const first = motions.planAndMove();
  const second = motions.planAndMove();
  sent[0]?.answer(-7, "preempted by goal 2");
  await first;
  expect(store.state.asked).toBe("move");
  expect(store.state.goal.code).toBeNull();
  sent[1]?.answer(1, "the arm is there");
  await second;
  expect(store.state.goal.code).toBe(1);
  expect(store.state.asked).toBe("nothing");
});

test("without a wish, or a plan, it says what to do first", async () => {
  const { store, motions } = desk();
  await motions.plan();
  expect(store.state.goal.message).toContain("Choose first");
  await motions.move();
  expect(store.state.goal.message).toContain("press Plan first");
});
