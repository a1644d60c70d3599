import { expect, test } from "vitest";
import { TWO_ARMS } from "../logic/robots.test.data";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { ArmCommands } from "./commands";
import type { Connection } from "./connection";
import { subscribeServoNode } from "./servo-node";

const LEFT_AND_RIGHT: Partial<State> = {
  limits: { left_a: [0, 1], right_a: [0, 1] },
  robot: TWO_ARMS,
  group: "left_arm",
};

function page(state: Partial<State> = {}, answer: object = { success: true, message: "" }) {
  const store = new Store<State>({ ...emptyState("ws://here"), ...state });
  const listeners = new Map<string, (message: object) => void>();
  const called: unknown[] = [];
  const connection = {
    subscribe: (topic: string, _type: string, listener: (message: never) => void) => listeners.set(topic, listener as never),
    call: (service: string, request: unknown) => Promise.resolve(called.push([service, request]) && answer),
  } as unknown as Connection;
  subscribeServoNode(connection, store);
  const tell = (topic: string, limit: string): void => {
    const values = [{ key: "speed_limit", value: limit }];
    listeners.get(topic)?.({ level: 0, name: "arm", message: "", hardware_id: "", values });
  };
  return { store, called, tell, topics: () => [...listeners.keys()].filter((topic) => topic.endsWith("/arm/state")), commands: new ArmCommands(connection, store) };
}

test("is that of the arm on a server with one, whose state is subscribed to already", () => {
  const { store, topics } = page();
  store.patch("arm", { speed_limit: 0.2 });
  expect(store.state.speed_limit).toBe(0.2);
  expect(topics()).toEqual([]);
});

test("of several arms is that of the planning group's, and the lowest for a group of all", () => {
  const { store, tell } = page(LEFT_AND_RIGHT);
  tell("/left/arm/state", "0.5");
  store.set({ group: "right_arm" });
  expect(store.state.speed_limit).toBe(1);
  tell("/left/arm/state", "0.4");
  tell("/right/arm/state", "0.3");
  expect(store.state.speed_limit).toBe(0.3);
  store.set({ group: "left_arm" });
  expect(store.state.speed_limit).toBe(0.4);
  store.patch("arm", { speed_limit: 0.3 });
  store.set({ group: "both_arms" });
  expect(store.state.speed_limit).toBe(0.3);
});

test("is set for the planning group's arm, with the share as the request", async () => {
  const { called, commands, store } = page(LEFT_AND_RIGHT);
  expect(await commands.setSpeedLimit(0.25)).toBe(true);
  store.set({ group: "both_arms" });
  await commands.setSpeedLimit(0.5);
  expect(called).toEqual([["/left/arm/set_speed_limit", { speed_limit: 0.25 }], ["/arm/set_speed_limit", { speed_limit: 0.5 }]]);
});

test("that is refused is a notice with the server's sentence", async () => {
  const { commands, store } = page({}, { success: false, message: "speed_limit must be 0.01 to 1" });
  expect(await commands.setSpeedLimit(0)).toBe(false);
  expect(JSON.stringify(store.state)).toContain("/arm/set_speed_limit: speed_limit must be 0.01 to 1");
});
