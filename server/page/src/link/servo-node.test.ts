import { afterEach, beforeEach, expect, test, vi } from "vitest";
import type { JogCommand } from "../logic/jog";
import { TWO_ARMS, WITH_FINGERS } from "../logic/robots.test.data";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { JogSender, PERIOD_MS, subscribeServoNode } from "./servo-node";

interface Sent {
  topic: string;
  message: { twist?: { linear: { x: number }; angular: { z: number } }; joint_names?: string[]; velocities?: number[]; header: { frame_id: string } };
}

const X: JogCommand = { kind: "tip", velocity: { x: 1 } };
const A: JogCommand = { kind: "joints", velocity: { a: -0.5 } };

function sender(state: Partial<State> = {}): { jog: JogSender; sent: Sent[]; called: unknown[]; timeouts: unknown[]; store: Store<State>; gripper: number[] } {
  const blank = emptyState("ws://here");
  const store = new Store<State>({ ...blank, link: { ...blank.link, connected: true }, ...state });
  const sent: Sent[] = [];
  const called: unknown[] = [];
  const timeouts: unknown[] = [];
  const gripper: number[] = [];
  const connection = {
    publish: (topic: string, _type: string, message: unknown) => {
      if (topic === "/servo_node/command_timeout") timeouts.push(message);
      else sent.push({ topic, message: message as Sent["message"] });
    },
    call: ((_service: string, request: unknown) => Promise.resolve(called.push(request))) as never,
  };
  const commands = { moveGripper: async (position: number) => void gripper.push(position), cancelGripper: () => void gripper.push(Number.NaN) };
  return { jog: new JogSender(connection, store, commands), sent, called, timeouts, store, gripper };
}

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

test("a held input is sent at once and then repeated, and its release halts at once", () => {
  const { jog, sent } = sender();
  jog.hold("key", X);
  expect(sent.map(({ message }) => message.twist?.linear.x)).toEqual([1]);
  vi.advanceTimersByTime(4 * PERIOD_MS);
  expect(sent).toHaveLength(5);
  jog.release("key");
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(0);
  vi.advanceTimersByTime(1000);
  expect(sent).toHaveLength(6);
});

test("several inputs add up, and only the last release halts", () => {
  const { jog, sent } = sender();
  jog.hold("one", { kind: "tip", velocity: { x: 0.4 } });
  jog.hold("two", { kind: "tip", velocity: { x: 0.4, yaw: 1 } });
  expect(sent.at(-1)?.message.twist).toMatchObject({ linear: { x: 0.8 }, angular: { z: 1 } });
  jog.release("two");
  vi.advanceTimersByTime(PERIOD_MS);
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(0.4);
});

test("the newest input decides between tip and joints, and the type of commands is switched", () => {
  const { jog, sent, called } = sender();
  jog.hold("tip", X);
  jog.hold("joint", A);
  expect(sent.at(-1)?.message).toMatchObject({ joint_names: ["a"], velocities: [-0.5] });
  jog.release("joint");
  expect(sent.at(-1)?.message).toMatchObject({ joint_names: ["a"], velocities: [0] });
  vi.advanceTimersByTime(PERIOD_MS);
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(1);
  expect(called).toEqual([{ command_type: 1 }, { command_type: 0 }, { command_type: 1 }]);
});

test("everything is released at once, and the inputs hear of it", () => {
  const { jog, sent } = sender();
  const heard = vi.fn();
  jog.onReleaseAll(heard);
  jog.hold("key", X);
  jog.releaseAll();
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(0);
  expect(heard).toHaveBeenCalledOnce();
});

test.each([
  ["a stop of this page", ({ jog }: ReturnType<typeof sender>) => jog.releaseAll()],
  ["anyone's stop", ({ store }: ReturnType<typeof sender>) => store.patch("arm", { last_stop: "7" })],
])("after %s nothing moves before every input is let go", (_, end) => {
  const page = sender();
  const { jog, sent } = page;
  jog.hold("key", X);
  end(page);
  expect([jog.busy, sent.at(-1)?.message.twist?.linear.x]).toEqual([true, 0]);
  const halted = sent.length;
  jog.hold("key", X);
  jog.hold("other", X);
  jog.release("key");
  vi.advanceTimersByTime(1000);
  expect(sent).toHaveLength(halted);
  jog.release("other");
  jog.hold("third", X);
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(1);
});

test("a page that nobody attends to waits for no release", () => {
  const { jog, sent } = sender();
  jog.hold("key", X);
  jog.leave();
  jog.hold("other", X);
  expect(sent.at(-1)?.message.twist?.linear.x).toBe(1);
});

test("another's control and a lost connection end it", () => {
  const held = sender();
  held.jog.hold("key", X);
  held.store.set({ identity: { address: "me", role: "view", version: "" } });
  vi.advanceTimersByTime(PERIOD_MS);
  expect(held.sent.at(-1)?.message.twist?.linear.x).toBe(0);
  const lost = sender();
  lost.jog.hold("key", X);
  lost.store.patch("link", { connected: false });
  vi.advanceTimersByTime(PERIOD_MS);
  expect(lost.sent).toHaveLength(1);
});

test("speeds are in the server's units", () => {
  const blank = emptyState("ws://here");
  const { jog, sent } = sender({ servo_node: { ...blank.servo_node, command_in_type: "speed_units" } });
  jog.hold("key", X);
  expect(sent[0]?.message.twist?.linear.x).toBe(0.2);
});

test("the gripper goes on in small goals while it is held, up to its limit", () => {
  const blank = emptyState("ws://here");
  const joints = { ...blank.joints, names: ["a", "left"], position_rad: [0, 0.045] };
  const { jog, gripper, sent } = sender({ robot: WITH_FINGERS, joints });
  jog.hold("open", { kind: "gripper", velocity: { opening: 1 } });
  vi.advanceTimersByTime(2000);
  expect(gripper.map((position) => Number(position.toFixed(4)))).toEqual([0.053, 0.06]);
  jog.release("open");
  vi.advanceTimersByTime(1000);
  expect([gripper.length, sent.length]).toEqual([2, 0]);
  jog.hold("close", { kind: "gripper", velocity: { opening: -1 } });
  jog.releaseAll();
  expect(gripper.at(-1)).toBeNaN();
});

test("commands expire early, every press is announced, and the page takes no control before it moves", () => {
  const { jog, timeouts } = sender();
  expect(timeouts).toEqual([]);
  jog.hold("key", X);
  jog.hold("key", X);
  expect(timeouts).toEqual([{ data: 0.08 }]);
  jog.hold("other", A);
  jog.release("other");
  expect(timeouts).toHaveLength(2);
});

const OF_TWO: Partial<State> = { robot: TWO_ARMS, group: "left_arm" };

test("of several arms that of the planning group is steered, and a change of the group halts it", () => {
  const { jog, sent, store } = sender(OF_TWO);
  jog.hold("joint", { kind: "joints", velocity: { left_a: 1 } });
  expect(sent.at(-1)).toMatchObject({ topic: "/left/servo_node/delta_joint_cmds", message: { velocities: [1] } });
  store.set({ group: "right_arm" });
  expect(sent.at(-1)).toMatchObject({ topic: "/left/servo_node/delta_joint_cmds", message: { velocities: [0] } });
  jog.release("joint");
  jog.hold("joint", { kind: "joints", velocity: { right_a: 1 } });
  expect(sent.at(-1)?.topic).toBe("/right/servo_node/delta_joint_cmds");
});

test("status and parameters are those of the arm that is steered", () => {
  const { store } = sender(OF_TWO);
  const listeners = new Map<string, (message: never) => void>();
  const subscribe = ((topic: string, _type: string, listener: (message: never) => void) => listeners.set(topic, listener)) as never;
  subscribeServoNode({ subscribe }, store);
  listeners.get("/left/servo_node/parameters")?.({ data: '{"linear_scale": 0.3}' } as never);
  store.set({ group: "right_arm" });
  listeners.get("/right/servo_node/parameters")?.({ data: '{"linear_scale": 0.1}' } as never);
  listeners.get("/left/servo_node/status")?.({ code: 3, message: "slower" } as never);
  expect(store.state.servo_node).toMatchObject({ linear_scale: 0.1, code: 0 });
  store.set({ group: "left_arm" });
  expect(store.state.servo_node.linear_scale).toBe(0.3);
  expect([...listeners.keys()].filter((topic) => topic.endsWith("status"))).toHaveLength(2);
});
