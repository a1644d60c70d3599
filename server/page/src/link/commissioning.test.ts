import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { Store, type PageStore } from "../state/store";
import { CommissioningCommands, subscribeCommissioning } from "./commissioning";
import type { Connection } from "./connection";
import type { CommissioningMessage } from "./messages";

const message = (patch: Partial<CommissioningMessage> = {}): CommissioningMessage => ({
  procedure: "verify",
  step: "pose 1",
  instruction: "Compare.",
  answers: ["same", "not the same"],
  progress: null,
  joints: [{ joint: "elbow", lowest: 1, present: 1, highest: 1, expected_width: 0, done: false, note: "", droop_rad: null }],
  findings: [],
  result: "",
  ...patch,
});

function told(): { store: PageStore; tell: (message: CommissioningMessage) => void } {
  const store = new Store(emptyState("ws://here"));
  let tell: (message: CommissioningMessage) => void = () => undefined;
  const subscribe = (_topic: string, _type: string, listener: typeof tell): void => void (tell = listener);
  subscribeCommissioning({ subscribe } as unknown as Connection, store);
  return { store, tell: (each) => tell(each) };
}

test("the procedure is shown as the server tells it, a number that is none as not measured", () => {
  const { store, tell } = told();
  tell(message());
  expect(store.state.commissioning).toMatchObject({ procedure: "verify", answers: ["same", "not the same"], progress: 0 });
  expect(store.state.commissioning?.joints[0]?.droop_rad).toBeNaN();
});

test("the joint in hand is that which moves, and none when the procedure is over", () => {
  const { store, tell } = told();
  const [elbow] = message().joints;
  for (const present of [100, 200]) tell(message({ joints: [{ ...elbow!, present }] }));
  expect(store.state.joint_in_hand).toEqual({ joint: "elbow", direction: 1 });
  tell(message({ procedure: "", joints: [] }));
  expect(store.state.joint_in_hand).toBeNull();
});

function commands(answer: () => Promise<unknown>): { sent: unknown[]; store: PageStore; commands: CommissioningCommands } {
  const store = new Store(emptyState("ws://here"));
  const sent: unknown[] = [];
  const call = (service: string, request: unknown): Promise<unknown> => {
    sent.push([service, request]);
    return answer();
  };
  return { sent, store, commands: new CommissioningCommands({ call } as unknown as Connection, store) };
}

test("procedures are begun, answered and cancelled by the services of the server", async () => {
  const { sent, commands: all } = commands(() => Promise.resolve({ success: true, message: "" }));
  await all.request("begin", { procedure: "calibrate", name: "left" });
  await all.request("answer", { step: "middle", answer: "done" });
  await all.request("cancel");
  expect(sent).toEqual([
    ["/arm/commissioning/begin", { procedure: "calibrate", name: "left" }],
    ["/arm/commissioning/answer", { step: "middle", answer: "done" }],
    ["/arm/commissioning/cancel", {}],
  ]);
});

test("a refusal is shown until the next request is taken", async () => {
  const answers = [{ success: false, message: "the arm moves" }, { success: true, message: "" }];
  const { store, commands: all } = commands(() => Promise.resolve(answers.shift()));
  expect(await all.request("begin", { procedure: "verify", name: "" })).toBe(false);
  expect(store.state.notices.map(({ text }) => text)).toEqual(["the arm moves"]);
  expect(await all.request("begin", { procedure: "verify", name: "" })).toBe(true);
  expect(store.state.notices).toEqual([]);
});

test("a connection that is lost is told like a refusal", async () => {
  const { store, commands: all } = commands(() => Promise.reject(new Error("the server cannot be reached")));
  expect(await all.request("cancel")).toBe(false);
  expect(store.state.notices.map(({ text }) => text)).toEqual(["the server cannot be reached"]);
});
