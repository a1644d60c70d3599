import { expect, test, vi } from "vitest";
import type { Waypoint } from "../logic/sequence";
import { emptyState } from "../state/state";
import { Store } from "../state/store";
import type { Connection } from "./connection";
import { SequencePlayer, setWaypoints } from "./sequence";

const WAYPOINT: Waypoint = { id: 1, name: "one", group: "", joints_rad: { pan: 0.4 }, motion: null, straight: false, speed: 1, gripper: null, pause_s: 0 };

test("an answer for a sequence that was emptied meanwhile is for no leg of it", async () => {
  vi.useFakeTimers();
  const store = new Store(emptyState("ws://here"));
  const answers: ((response: unknown) => void)[] = [];
  const call = vi.fn(() => new Promise((resolve) => answers.push(resolve)));
  new SequencePlayer({ call } as unknown as Connection, store);
  store.patch("link", { connected: true });
  setWaypoints(store, [WAYPOINT]);
  await vi.runAllTimersAsync();
  expect(answers).toHaveLength(1);
  setWaypoints(store, []);
  answers[0]?.({ motion_plan_response: { error_code: { val: -1, message: "no" }, trajectory: {} } });
  await vi.runAllTimersAsync();
  expect(store.state.sequence.checks).toEqual([]);
  vi.useRealTimers();
});
