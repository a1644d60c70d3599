import { expect, test } from "vitest";
import { emptyState, type State } from "../state/state";
import { statePill, statusCode, statusText } from "./status";

function state(patch: { arm?: Partial<State["arm"]>; goal?: Partial<State["goal"]>; pending_request?: State["pending_request"]; up?: boolean }): State {
  const empty = emptyState("ws://here");
  return {
    ...empty,
    link: { ...empty.link, connected: patch.up ?? true },
    arm: { ...empty.arm, mode: "holding", ...patch.arm },
    goal: { ...empty.goal, ...patch.goal },
    pending_request: patch.pending_request ?? "nothing",
  };
}

test.each([
  ["IDLE", {}],
  ["OFFLINE", { up: false }],
  ["FAULT", { arm: { mode: "fault" }, goal: { state: "executing" } }],
  ["PLANNING", { goal: { state: "planning" } }],
  ["PLANNING", { pending_request: "plan" as const }],
  ["EXECUTING", { arm: { mode: "moving" } }],
  ["PAUSED", { arm: { mode: "moving", course: "paused" } }],
  ["STOPPED", { goal: { state: "done", code: -7 } }],
  ["IDLE", { goal: { state: "done", code: -31 } }],
  ["RELAXED", { arm: { mode: "relaxed" }, goal: { state: "done", code: -7 } }],
])("%s", (label, patch) => {
  expect(statePill(state(patch)).label).toBe(label);
});

test("a refusal is told with MoveIt's code and the server's sentence", () => {
  const refused = state({ goal: { state: "done", code: -31, message: "out of reach" } });
  expect(statusText(refused)).toBe("Out of reach.");
  expect(statusCode(refused)).toBe("NO_IK_SOLUTION (-31)");
});

test("a fault is told with its remedy", () => {
  const faulty = state({ arm: { mode: "fault", fault: "overload", fault_message: "Too heavy.", fault_remedy: "Lift it." } });
  expect(statusText(faulty)).toBe("Too heavy. Lift it.");
  expect(statusCode(faulty)).toBe("overload");
});

test.each([
  ["CHECKING", ""],
  ["CHECKING", "connected"],
])("an arm that is not ready yet is no fault: %s", (label, mode) => {
  expect(statePill(state({ arm: { mode } }))).toEqual({ label, kind: "off" });
});

test("a server that starts the arm is checking, and one without an arm says what to do", () => {
  expect(statePill(state({ arm: { mode: "disconnected", task: "starting" } })).label).toBe("CHECKING");
  const without = state({ arm: { mode: "disconnected", reason: "no port" } });
  expect([statePill(without).label, statusText(without)]).toEqual(["NO ARM", "No arm is connected. Check its cable and its power. No port."]);
});

test("a page that has never been connected is connecting, and not offline", () => {
  expect(statePill(state({ up: false, arm: { mode: "" } })).label).toBe("CONNECTING");
});

test("a server that does not let the page in wants a token, and is not away", () => {
  const state = emptyState("ws://here");
  expect(statusText({ ...state, link: { ...state.link, refused: "auth" } })).toBe("The server wants a token.");
});
