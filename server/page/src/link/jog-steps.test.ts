import { expect, test } from "vitest";
import type { JogCommand } from "../logic/jog";
import { WITH_FINGERS } from "../logic/robots.test.data";
import type { JointValues } from "../state/state";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { JogSteps } from "./jog-steps";
import { JogSender } from "./servo-node";

const A: JogCommand = { kind: "joints", velocity: { a: 1 } };
const settled = (): Promise<void> => new Promise((resolve) => setTimeout(resolve));

function stepping(state: Partial<State> = {}) {
  const blank = emptyState("ws://here");
  const joints = { ...blank.joints, names: ["a", "left"], position_rad: [0.48, 0.01] };
  const store = new Store<State>({ ...blank, link: { ...blank.link, connected: true }, robot: WITH_FINGERS, joints, commanded_rad: { a: 0.5 }, ...state });
  const goals: JointValues[] = [];
  const arrived: (() => void)[] = [];
  const positions: number[] = [];
  const called: [string, unknown][] = [];
  const moveTo = (goal: JointValues): Promise<void> => {
    goals.push(goal);
    return new Promise((resolve) => arrived.push(resolve));
  };
  const answers: Record<string, unknown> = {
    "/compute_fk": { pose_stamped: [{ pose: { position: { x: 0.2, y: 0, z: 0.1 }, orientation: { x: 0, y: 0, z: Math.SQRT1_2, w: Math.SQRT1_2 } } }], error_code: { val: 1, message: "" } },
    "/compute_ik": { solution: { joint_state: { name: ["a"], position: [0.7] } }, error_code: { val: 1, message: "" } },
  };
  const call = (service: string, request: unknown): Promise<unknown> => {
    called.push([service, request]);
    return Promise.resolve(answers[service]);
  };
  const commands = { moveGripper: async (position: number) => void positions.push(Number(position.toFixed(6))), cancelGripper: () => undefined };
  const connection = { publish: () => undefined, call } as never;
  const jog = new JogSender(connection, store, commands);
  return { steps: new JogSteps(connection, store, { moveTo }, commands, jog), store, jog, goals, arrived, positions, called, answers };
}

test("quick presses add up, from the commanded position, and a step after them begins there again", async () => {
  const { steps, goals, arrived } = stepping();
  for (const _ of [1, 2, 3]) steps.step(A, 0.1, 0.5);
  await settled();
  expect(goals.map(({ a }) => Number(a?.toFixed(6)))).toEqual([0.6, 0.7, 0.8]);
  for (const arrive of arrived) arrive();
  await settled();
  steps.step(A, 0.1, 0.5);
  await settled();
  expect(goals.at(-1)?.a).toBeCloseTo(0.6);
});

test("a stop forgets the presses before it, and the goal that they have added up to", async () => {
  const { steps, jog, goals } = stepping();
  steps.step(A, 0.1, 0.5);
  jog.releaseAll();
  await settled();
  expect(goals).toEqual([]);
  steps.step(A, 0.1, 0.5);
  await settled();
  expect(goals.at(-1)?.a).toBeCloseTo(0.6);
});

test("a step ends at the joint's limit, and nothing moves while another input is held", async () => {
  const { steps, jog, goals } = stepping({ limits: { a: [-1, 0.55] } });
  steps.step(A, 0.1, 0.5);
  await settled();
  expect(goals).toEqual([{ a: 0.55 }]);
  jog.hold("key", A);
  steps.step(A, -0.1, 0.5);
  await settled();
  expect(goals).toHaveLength(1);
});

test.each([
  ["base", "x", { position: { x: 0.21, y: 0 } }],
  ["tool", "x", { position: { x: 0.2, y: 0.01 } }],
  ["base", "roll", { position: { x: 0.2 }, orientation: { z: Math.SQRT1_2 * Math.cos(0.005) } }],
] as const)("the tip is moved in the frame %s along or about %s, near where it is", async (frame, axis, pose) => {
  const { steps, jog, goals, called } = stepping();
  jog.frame = frame;
  steps.step({ kind: "tip", velocity: { [axis]: 1 } }, 0.01, 0.5);
  await settled();
  expect(goals).toEqual([{ a: 0.7 }]);
  const [, asked] = called[1] ?? [];
  const { ik_request } = asked as { ik_request: { pose_stamped: { pose: { position: Record<string, number>; orientation: Record<string, number> } } } };
  for (const [part, values] of Object.entries(pose)) {
    for (const [key, value] of Object.entries(values)) expect(ik_request.pose_stamped.pose[part as "position"][key]).toBeCloseTo(value as number, 9);
  }
});

test("the server's reason against a step is shown", async () => {
  const { steps, store, goals, answers } = stepping();
  answers["/compute_ik"] = { solution: { joint_state: { name: [], position: [] } }, error_code: { val: -31, message: "out of reach" } };
  steps.step({ kind: "tip", velocity: { x: 1 } }, 0.01, 0.5);
  await settled();
  expect([goals, store.state.notices.map(({ text }) => text)]).toEqual([[], ["out of reach"]]);
});

test("the gripper opens by a share of its range, up to its end", async () => {
  const { steps, positions } = stepping();
  steps.step({ kind: "gripper", velocity: { opening: 1 } }, 0.5, 0.5);
  await settled();
  steps.step({ kind: "gripper", velocity: { opening: -1 } }, 0.5, 0.5);
  await settled();
  expect(positions).toEqual([0.04, 0]);
});
