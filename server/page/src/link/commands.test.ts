import { expect, test, vi } from "vitest";
import { WITH_FINGERS } from "../logic/robots.test.data";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { ArmCommands, StopCommand } from "./commands";
import type { Connection } from "./connection";

function stopCommand(link: Partial<Connection>): { press: () => Promise<void>; phase: () => string; text: () => string; cancelled: () => number } {
  const store = new Store(emptyState("ws://here"));
  const cancel = vi.fn();
  const stop = new StopCommand({ publish: () => undefined, ...link } as unknown as Connection, store, cancel);
  return {
    press: () => stop.stop(),
    phase: () => store.state.stop.phase,
    text: () => store.state.stop.text,
    cancelled: () => cancel.mock.calls.length,
  };
}

test("is published first, then called, and acknowledged by the answer", async () => {
  const order: string[] = [];
  const s = stopCommand({
    publish: (topic: string) => void order.push(topic),
    call: ((service: string) => Promise.resolve(order.push(service) && { success: true, message: "the arm stands" })) as Connection["call"],
  });
  const pressed = s.press();
  expect(s.phase()).toBe("asked");
  await pressed;
  expect(order).toEqual(["/stop", "/arm/stop"]);
  expect([s.phase(), s.text()]).toEqual(["acknowledged", "acknowledged: the arm stands"]);
  expect(s.cancelled()).toBe(1);
});

test("says that it was not acknowledged, and what stops the arm then", async () => {
  const s = stopCommand({
    publish: () => {
      throw new Error("the server cannot be reached");
    },
  });
  await s.press();
  expect(s.phase()).toBe("failed");
  expect(s.text()).toContain("not acknowledged: the server cannot be reached");
  expect(s.text()).toContain("power switch");
});

test("says when the arm did not stop", async () => {
  const s = stopCommand({ call: (() => Promise.resolve({ success: false, message: "it is disconnected" })) as Connection["call"] });
  await s.press();
  expect([s.phase(), s.text()]).toEqual(["failed", "not stopped: it is disconnected"]);
});

test("a gripper is moved by the action that the server offers for it", async () => {
  const store = new Store<State>({ ...emptyState("ws://here"), robot: WITH_FINGERS });
  const sent: unknown[] = [];
  const goal = (action: string, _type: string, message: unknown): unknown => {
    sent.push([action, message]);
    return { result: Promise.resolve({ status: 4, values: {}, reason: "" }) };
  };
  const commands = new ArmCommands({ goal } as unknown as Connection, store);
  await commands.moveGripper(0.02);
  expect(sent).toEqual([["/gripper_controller/gripper_cmd", { command: { position: 0.02, max_effort: 0 } }]]);
});

test("a joint group is selected for this page and for the server, and the goal of the group before is gone", () => {
  const store = new Store<State>({ ...emptyState("ws://here"), selection: { kind: "joints", joints_rad: { a: 1 } } });
  const sent: unknown[] = [];
  const publish = (...message: unknown[]): void => void sent.push(message);
  const commands = new ArmCommands({ publish } as unknown as Connection, store);
  commands.selectGroup("left");
  expect(sent).toEqual([["/moveit_goal_group", "std_msgs/String", { data: "left" }]]);
  expect(store.state.group).toBe("left");
  expect(store.state.selection.kind).toBe("none");
});
