import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { askNames, backoff_s, Connection, serverUrl, type ConnectionStatus } from "./connection";

/** Fake of the browser's WebSocket, opened and lost by the test. */
class FakeSocket {
  static made: FakeSocket[] = [];
  readonly sent: Record<string, unknown>[] = [];
  closed = false;
  onopen: (() => void) | null = null;
  onclose: ((event: { code: number; reason: string }) => void) | null = null;
  onmessage: ((event: { data: string }) => void) | null = null;

  constructor() {
    FakeSocket.made.push(this);
  }

  /** Record an operation. */
  send(text: string): void {
    this.sent.push(JSON.parse(text) as Record<string, unknown>);
  }

  /** Record that it was closed. */
  close(): void {
    this.closed = true;
  }

  /** Lose the connection. */
  lose(code = 1006, reason = ""): void {
    this.onclose?.({ code, reason });
  }

  /** Receive an operation of the server. */
  receive(operation: object): void {
    this.onmessage?.({ data: JSON.stringify(operation) });
  }

  /** Return the recorded operations of one kind. */
  ops(op: string): Record<string, unknown>[] {
    return this.sent.filter((message) => message.op === op);
  }

  /** Answer the first call of a service. */
  answer(service: string, values: unknown): void {
    const call = this.ops("call_service").find((message) => message.service === service);
    this.receive({ op: "service_response", id: call?.id, values, result: true });
  }
}

test("waits twice as long after each failure, and 2 s at most", () => {
  expect([1, 2, 3, 4, 5, 50].map(backoff_s)).toEqual([0.25, 0.5, 1, 2, 2, 2]);
});

test("the server is where the page came from, without its token", () => {
  expect(serverUrl("http://h:9090/index.html?token=abc#token=def")).toBe("ws://h:9090/?ros=2");
  expect(serverUrl("https://h/arm/")).toBe("wss://h/arm/?ros=2");
});

const newest = (): FakeSocket => FakeSocket.made.at(-1) as FakeSocket;
let statuses: ConnectionStatus[] = [];
let connection: Connection;
let token: string | null = null;
let woken: (() => void)[] = [];

beforeEach(() => {
  vi.useFakeTimers();
  woken = [];
  const target = { addEventListener: (_: string, wake: () => void) => woken.push(wake), visibilityState: "visible" };
  vi.stubGlobal("window", target);
  vi.stubGlobal("document", target);
  vi.stubGlobal("WebSocket", FakeSocket);
  FakeSocket.made = [];
  statuses = [];
  token = null;
  connection = new Connection("ws://here", (status) => statuses.push(status), () => token);
  connection.open();
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("comes back by itself, with every subscription, and sends nothing that is old", () => {
  connection.subscribe("/joint_states", "sensor_msgs/msg/JointState", () => undefined, 33);
  newest().onopen?.();
  connection.publish("/stop", "std_msgs/Empty", {});
  newest().lose();
  expect(() => connection.publish("/moveit_goal_named", "std_msgs/msg/String", { data: "home" })).toThrow("cannot be reached");
  vi.advanceTimersByTime(260);
  expect(FakeSocket.made).toHaveLength(2);
  newest().onopen?.();
  expect(newest().ops("subscribe").map((message) => message.topic)).toEqual(["/joint_states"]);
  expect(newest().ops("publish")).toEqual([]);
  expect(statuses.map(({ connected }) => connected)).toEqual([true, false, true]);
});

test("a call ends when the link is lost, and when its time is up", async () => {
  newest().onopen?.();
  const lost = expect(connection.call("/arm/stop", {})).rejects.toThrow("the connection was lost");
  newest().lose();
  await lost;
  vi.advanceTimersByTime(260);
  newest().onopen?.();
  const late = expect(connection.call("/arm/stop", {}, 1)).rejects.toThrow("no answer within 1 s");
  vi.advanceTimersByTime(1001);
  await late;
});

test("names that are asked for once come as late as a server answers that lives, and are missing where it does not know the service", async () => {
  newest().onopen?.();
  const [names, unknown] = [askNames(connection, "/teach/list"), askNames(connection, "/arm/scenes/list")];
  const [, call] = newest().ops("call_service").slice(-2);
  newest().receive({ op: "service_response", id: call?.id, values: "no such service", result: false });
  for (let seconds = 0; seconds < 60; seconds += 1) {
    await vi.advanceTimersByTimeAsync(1000);
    newest().receive({ op: "publish", topic: "/joint_states", msg: {} });
  }
  newest().answer("/teach/list", { names: ["wave"] });
  expect(await names).toEqual(["wave"]);
  expect(await unknown).toBeNull();
});

test("a response that has no room for its reason gets it from the status about the same call", async () => {
  newest().onopen?.();
  expect(newest().ops("set_level")).toEqual([{ op: "set_level", level: "error" }]);
  const answer = connection.call("/apply_planning_scene", {});
  const call = newest().ops("call_service").find(({ service }) => service === "/apply_planning_scene");
  newest().receive({ op: "status", id: "of another call", msg: "call_service: service /apply_planning_scene: not ours" });
  newest().receive({ op: "status", id: call?.id, msg: "call_service: service /apply_planning_scene: no such link" });
  newest().answer("/apply_planning_scene", { success: false });
  expect(await answer).toEqual({ success: false, refusal: "no such link" });
});

test("a goal tells its status and result, also of one that failed", async () => {
  newest().onopen?.();
  const { result, cancel } = connection.goal<{ error_code: { val: number } }>("/move_action", "moveit_msgs/action/MoveGroup", {});
  const id = newest().ops("send_action_goal")[0]?.id;
  cancel();
  expect(newest().ops("cancel_action_goal")).toEqual([{ op: "cancel_action_goal", id, action: "/move_action" }]);
  newest().receive({ id, op: "action_result", status: 6, result: true, values: { error_code: { val: -7 } } });
  await expect(result).resolves.toEqual({ status: 6, values: { error_code: { val: -7 } }, reason: "" });
});

test("a goal that was not taken tells why", async () => {
  newest().onopen?.();
  const { result } = connection.goal("/move_action", "moveit_msgs/action/MoveGroup", {});
  const id = newest().ops("send_action_goal")[0]?.id;
  newest().receive({ id, op: "action_result", status: 6, result: false, values: "the field is wrong" });
  await expect(result).resolves.toMatchObject({ values: null, reason: "the field is wrong" });
});

test("latency is told, and a server that falls silent is left", async () => {
  newest().onopen?.();
  vi.advanceTimersByTime(5);
  newest().answer("/rosapi/get_time", {});
  await vi.advanceTimersByTimeAsync(0);
  expect(statuses.at(-1)).toEqual({ connected: true, latency_ms: 5, refused: "" });
  const silent = newest();
  await vi.advanceTimersByTimeAsync(2000 + 4001);
  expect(silent.closed).toBe(true);
  expect(statuses.at(-1)).toEqual({ connected: false, latency_ms: null, refused: "" });
});

test("a server whose words the page has not read yet is not left", async () => {
  newest().onopen?.();
  connection.subscribe("/joint_states", "sensor_msgs/msg/JointState", () => undefined);
  for (let round = 0; round < 5; round += 1) {
    await vi.advanceTimersByTimeAsync(3999);
    newest().receive({ op: "publish", topic: "/joint_states", msg: {} });
  }
  expect(FakeSocket.made).toHaveLength(1);
});

test("messages go to the listeners of their topic, and no error of one keeps them from the others", () => {
  const heard: unknown[] = [];
  vi.stubGlobal("reportError", (error: Error) => heard.push(error.message));
  newest().onopen?.();
  connection.subscribe("/a", "std_msgs/msg/String", () => {
    throw new Error("broken");
  });
  const end = connection.subscribe("/a", "std_msgs/msg/String", (message) => heard.push(message));
  connection.subscribe("/b", "std_msgs/msg/String", () => heard.push("other"));
  newest().receive({ op: "publish", topic: "/a", msg: { data: "x" } });
  end();
  newest().receive({ op: "publish", topic: "/a", msg: { data: "y" } });
  expect(heard).toEqual(["broken", { data: "x" }, "broken"]);
  expect(newest().ops("unsubscribe")).toHaveLength(1);
});

test("attempts that fail follow each other ever more slowly", async () => {
  for (const wait_ms of [250, 500, 1000, 2000, 2000]) {
    newest().lose();
    const before = FakeSocket.made.length;
    await vi.advanceTimersByTimeAsync(wait_ms - 1);
    expect(FakeSocket.made).toHaveLength(before);
    await vi.advanceTimersByTimeAsync(1);
    expect(FakeSocket.made).toHaveLength(before + 1);
  }
});

test("the token is shown before anything else, after every connection", async () => {
  token = "secret";
  connection.subscribe("/joint_states", "sensor_msgs/msg/JointState", () => undefined);
  for (let round = 0; round < 2; round += 1) {
    newest().onopen?.();
    expect(newest().sent[0]).toEqual({ op: "auth", token: "secret" });
    newest().lose();
    await vi.advanceTimersByTimeAsync(260);
  }
});

test("without a token none is shown", () => {
  newest().onopen?.();
  expect(newest().ops("auth")).toEqual([]);
});

test("a server that does not let the page in is tried again only with another token", async () => {
  newest().onopen?.();
  newest().lose(1008, "auth: wrong");
  expect(statuses.at(-1)).toEqual({ connected: false, latency_ms: null, refused: "auth: wrong" });
  expect(() => connection.publish("/stop", "std_msgs/Empty", {})).toThrow("wants a token: auth: wrong");
  await vi.advanceTimersByTimeAsync(60_000);
  expect(FakeSocket.made).toHaveLength(1);
  token = "other";
  connection.reopen();
  expect(statuses.at(-1)?.refused).toBe("");
  newest().onopen?.();
  expect(newest().ops("auth")).toEqual([{ op: "auth", token: "other" }]);
});

test("a device that wakes up does not try a refused token again", () => {
  newest().onopen?.();
  newest().lose(1008, "auth: wrong");
  for (const wake of woken) wake();
  expect(FakeSocket.made).toHaveLength(1);
});

test("a server that has let the page in may close for other reasons, and is tried again", async () => {
  newest().onopen?.();
  newest().answer("/rosapi/get_time", {});
  await vi.advanceTimersByTimeAsync(0);
  newest().lose(1008, "replies are not read");
  await vi.advanceTimersByTimeAsync(260);
  expect(FakeSocket.made).toHaveLength(2);
});
