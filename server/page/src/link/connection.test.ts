import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { backoff_s, Connection, serverUrl, type ConnectionStatus } from "./connection";

/** Fake of roslib's connection, opened and lost by the test. */
const FakeRos = vi.hoisted(() => {
  class FakeRos {
    static made: FakeRos[] = [];
    readonly sent: Record<string, unknown>[] = [];
    isConnected = false;
    closed = false;
    private readonly listeners = new Map<string, Set<(message: unknown) => void>>();

    constructor() {
      FakeRos.made.push(this);
    }

    /** Add a listener. */
    on(event: string, listener: (message: unknown) => void): void {
      this.listeners.set(event, (this.listeners.get(event) ?? new Set()).add(listener));
    }

    /** Add a listener; the tests emit each event once. */
    once(event: string, listener: (message: unknown) => void): void {
      this.on(event, listener);
    }

    /** Remove a listener. */
    off(event: string, listener: (message: unknown) => void): void {
      this.listeners.get(event)?.delete(listener);
    }

    /** Remove all listeners. */
    removeAllListeners(): void {
      this.listeners.clear();
    }

    /** Emit an event. */
    emit(event: string, message: unknown = {}): void {
      for (const listener of [...(this.listeners.get(event) ?? [])]) listener(message);
    }

    /** Record an operation. */
    callOnConnection(message: Record<string, unknown>): void {
      this.sent.push(message);
    }

    /** Start to connect; the test calls up(). */
    connect(): Promise<void> {
      return Promise.resolve();
    }

    /** Record that it was closed. */
    close(): void {
      this.closed = true;
    }

    /** Open the connection. */
    up(): void {
      this.isConnected = true;
      this.emit("connection");
    }

    /** Return the recorded operations of one kind. */
    ops(op: string): Record<string, unknown>[] {
      return this.sent.filter((message) => message.op === op);
    }

    /** Answer the first call of a service. */
    answer(service: string, values: unknown): void {
      const call = this.ops("call_service").find((message) => message.service === service);
      this.emit(String(call?.id), { op: "service_response", id: call?.id, values, result: true });
    }
  }
  return FakeRos;
});
type FakeRos = InstanceType<typeof FakeRos>;

vi.mock("roslib", async (original) => ({ ...(await original<typeof import("roslib")>()), Ros: FakeRos }));

test("waits twice as long after each failure, and 2 s at most", () => {
  expect([1, 2, 3, 4, 5, 50].map(backoff_s)).toEqual([0.25, 0.5, 1, 2, 2, 2]);
});

test("the server is where the page came from, without its token", () => {
  expect(serverUrl("http://h:9090/index.html?token=abc#token=def")).toBe("ws://h:9090/?ros=2");
  expect(serverUrl("https://h/arm/")).toBe("wss://h/arm/?ros=2");
});

const newest = (): FakeRos => FakeRos.made.at(-1) as FakeRos;
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
  FakeRos.made = [];
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
  connection.subscribe("/joint_states", "sensor_msgs/JointState", () => undefined, 33);
  newest().up();
  connection.publish("/stop", "std_msgs/Empty", {});
  newest().emit("close");
  expect(connection.isConnected).toBe(false);
  expect(() => connection.publish("/moveit_goal_named", "std_msgs/String", { data: "home" })).toThrow("cannot be reached");
  vi.advanceTimersByTime(260);
  expect(FakeRos.made).toHaveLength(2);
  newest().up();
  expect(newest().ops("subscribe").map((message) => message.topic)).toEqual(["/joint_states"]);
  expect(newest().ops("publish")).toEqual([]);
  expect(statuses.map(({ connected }) => connected)).toEqual([true, false, true]);
});

test("a call ends when the link is lost, and when its time is up", async () => {
  newest().up();
  const lost = expect(connection.call("/arm/stop", {})).rejects.toThrow("the connection was lost");
  newest().emit("close");
  await lost;
  vi.advanceTimersByTime(260);
  newest().up();
  const late = expect(connection.call("/arm/stop", {}, 1)).rejects.toThrow("no answer within 1 s");
  vi.advanceTimersByTime(1001);
  await late;
});

test("a response that has no room for its reason gets it from the status about the same call", async () => {
  newest().up();
  expect(newest().ops("set_level")).toEqual([{ op: "set_level", level: "error" }]);
  const answer = connection.call("/apply_planning_scene", {});
  const call = newest().ops("call_service").find(({ service }) => service === "/apply_planning_scene");
  newest().emit("status:of another call", { msg: "call_service: service /apply_planning_scene: not ours" });
  newest().emit(`status:${call?.id as string}`, { msg: "call_service: service /apply_planning_scene: no such link" });
  newest().answer("/apply_planning_scene", { success: false });
  expect(await answer).toEqual({ success: false, refusal: "no such link" });
});

test("a goal tells its status and result, also of one that failed", async () => {
  newest().up();
  const { result, cancel } = connection.goal<{ error_code: { val: number } }>("/move_action", "moveit_msgs/action/MoveGroup", {});
  const id = newest().ops("send_action_goal")[0]?.id;
  cancel();
  expect(newest().ops("cancel_action_goal")).toEqual([{ op: "cancel_action_goal", id, action: "/move_action" }]);
  newest().emit(String(id), { op: "action_result", status: 6, result: true, values: { error_code: { val: -7 } } });
  await expect(result).resolves.toEqual({ status: 6, values: { error_code: { val: -7 } }, reason: "" });
});

test("a goal that was not taken tells why", async () => {
  newest().up();
  const { result } = connection.goal("/move_action", "moveit_msgs/action/MoveGroup", {});
  const id = newest().ops("send_action_goal")[0]?.id;
  newest().emit(String(id), { op: "action_result", status: 6, result: false, values: "the field is wrong" });
  await expect(result).resolves.toMatchObject({ values: null, reason: "the field is wrong" });
});

test("latency is told, and a server that falls silent is left", async () => {
  newest().up();
  vi.advanceTimersByTime(5);
  newest().answer("/rosapi/get_time", {});
  await vi.advanceTimersByTimeAsync(0);
  expect(statuses.at(-1)).toEqual({ connected: true, latency_ms: 5, refused: "" });
  const silent = newest();
  await vi.advanceTimersByTimeAsync(2000 + 4001);
  expect(silent.closed).toBe(true);
  expect(statuses.at(-1)).toEqual({ connected: false, latency_ms: null, refused: "" });
});

test("attempts that fail follow each other ever more slowly", async () => {
  for (const wait_ms of [250, 500, 1000, 2000, 2000]) {
    newest().emit("close");
    const before = FakeRos.made.length;
    await vi.advanceTimersByTimeAsync(wait_ms - 1);
    expect(FakeRos.made).toHaveLength(before);
    await vi.advanceTimersByTimeAsync(1);
    expect(FakeRos.made).toHaveLength(before + 1);
  }
});

test("the token is shown before anything else, after every connection", async () => {
  token = "secret";
  connection.subscribe("/joint_states", "sensor_msgs/JointState", () => undefined);
  for (let round = 0; round < 2; round += 1) {
    newest().up();
    expect(newest().sent[0]).toEqual({ op: "auth", token: "secret" });
    newest().emit("close");
    await vi.advanceTimersByTimeAsync(260);
  }
});

test("without a token none is shown", () => {
  newest().up();
  expect(newest().ops("auth")).toEqual([]);
});

test("a server that does not let the page in is tried again only with another token", async () => {
  newest().up();
  newest().emit("close", { code: 1008, reason: "auth: wrong" });
  expect(statuses.at(-1)).toEqual({ connected: false, latency_ms: null, refused: "auth: wrong" });
  expect(() => connection.publish("/stop", "std_msgs/Empty", {})).toThrow("wants a token: auth: wrong");
  await vi.advanceTimersByTimeAsync(60_000);
  expect(FakeRos.made).toHaveLength(1);
  token = "other";
  connection.reopen();
  expect(statuses.at(-1)?.refused).toBe("");
  newest().up();
  expect(newest().ops("auth")).toEqual([{ op: "auth", token: "other" }]);
});

test("a device that wakes up does not try a refused token again", () => {
  newest().up();
  newest().emit("close", { code: 1008, reason: "auth: wrong" });
  for (const wake of woken) wake();
  expect(FakeRos.made).toHaveLength(1);
});

test("a server that has let the page in may close for other reasons, and is tried again", async () => {
  newest().up();
  newest().answer("/rosapi/get_time", {});
  await vi.advanceTimersByTimeAsync(0);
  newest().emit("close", { code: 1008, reason: "replies are not read" });
  await vi.advanceTimersByTimeAsync(260);
  expect(FakeRos.made).toHaveLength(2);
});
