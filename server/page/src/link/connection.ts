import type { State } from "../state/state";
import { t } from "../texts/texts";
import type { Received } from "./messages";

/** Failure to reach the server or to get its answer; the message is shown to the user. */
export class ConnectionError extends Error {
  override readonly name = "ConnectionError";
}

/** Return the WebSocket address of the server, which is that of the page; the page reads the spelling of ROS 2. */
export function serverUrl(page: string): string {
  const url = new URL("./?ros=2", page);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
}

/** Delay before the first attempt to reconnect [s]; it doubles with each failure up to the maximum. */
const INITIAL_BACKOFF_S = 0.25;
const MAX_BACKOFF_S = 2;

/** Return the delay before the next attempt to connect [s], after one failure or more. */
export function backoff_s(failures: number): number {
  return Math.min(MAX_BACKOFF_S, INITIAL_BACKOFF_S * 2 ** Math.max(0, failures - 1));
}

/**
 * Time between two heartbeats [ms], and heartbeats in a row without a word of the server after which it is left.
 *
 * Counted, as a page that stood still has not read what has come meanwhile: time alone would blame the server for it.
 */
const HEARTBEAT_MS = 2000;
const SILENT_HEARTBEATS = 2;

/** Time for an answer to what is asked once: while the server lives, which the heartbeats see; else it is asked anew. */
export const WHILE_CONNECTED_S = Infinity;

export const STATUS_ABORTED = 6;

/** Final status of action_msgs/GoalStatus with the result, or with the reason where the goal was rejected. */
export interface GoalResult<Result> {
  status: number;
  values: Result | null;
  reason: string;
}

export interface GoalHandle<Result> {
  result: Promise<GoalResult<Result>>;
  cancel: () => void;
}

/** Condition of the connection: its part of the state of the page. */
export type ConnectionStatus = Omit<State["link"], "url">;

/** Close code of RFC 6455, section 7.4.1, for a connection without a valid token. */
const POLICY_VIOLATION = 1008;

interface Subscription {
  id: string;
  topic: string;
  type: string;
  throttle_ms: number;
  queue_length: number;
  listener: (message: never) => void;
}

/** Operation of rosbridge that the server sends (rosbridge v2 protocol, section 3). */
interface Operation {
  op: string;
  id?: string;
  topic: string;
  msg: unknown;
  status: number;
  result: boolean;
  values: unknown;
}

interface Waiting {
  /** Reason that the server has told before the answer (docs/protocol.md, "Status"). */
  refusal: string;
  answer: (operation: Operation) => void;
  lost: () => void;
}

/** rosbridge connection that reconnects by itself and restores its subscriptions. */
export class Connection {
  private socket: WebSocket | null = null;
  private connected = false;
  /** True once the server has answered a request of this connection. */
  private accepted = false;
  private refused = "";
  private failures = 0;
  private number = 0;
  private silent_heartbeats = 0;
  private reconnect_timer: ReturnType<typeof setTimeout> | undefined;
  private heartbeat_timer: ReturnType<typeof setInterval> | undefined;
  private readonly subscriptions = new Set<Subscription>();
  private readonly advertised = new Set<string>();
  private readonly waiting = new Map<string, Waiting>();
  private readonly closing = new AbortController();

  /**
   * @param url - WebSocket address of the server.
   * @param onStatus - called whenever the connection opens or closes, and with every latency.
   * @param token - returns the token to send; null for none.
   */
  constructor(
    readonly url: string,
    private readonly onStatus: (status: ConnectionStatus) => void,
    private readonly token: () => string | null = () => null,
  ) {}

  /** Connect, and stay connected until it is closed. */
  open(): void {
    const retryNow = (): void => this.retryNow();
    const { signal } = this.closing;
    window.addEventListener("online", retryNow, { signal });
    document.addEventListener("visibilitychange", retryNow, { signal });
    this.connect();
  }

  close(): void {
    this.closing.abort();
    this.disconnect();
  }

  reopen(): void {
    this.disconnect();
    this.onStatus({ connected: false, latency_ms: null, refused: "" });
    this.connect();
  }

  /**
   * Subscribe to a topic, now and after every reconnection.
   *
   * @param throttle_ms - least time between two messages.
   * @param queue_length - 0 drops messages that come too early, which costs the server least; 1 keeps the newest.
   * @returns function that ends the subscription.
   */
  subscribe<Type extends keyof Received>(topic: string, type: Type, listener: (message: Received[Type]) => void, throttle_ms = 0, queue_length = throttle_ms > 0 ? 1 : 0): () => void {
    const subscription: Subscription = { id: this.newId("subscribe", topic), topic, type, throttle_ms, queue_length, listener };
    this.subscriptions.add(subscription);
    if (this.connected) this.sendSubscription(subscription);
    return () => {
      this.subscriptions.delete(subscription);
      if (this.connected) this.send({ op: "unsubscribe", id: subscription.id, topic });
    };
  }

  /** Publish a message; throw a ConnectionError while there is no connection. */
  publish(topic: string, type: string, msg: unknown): void {
    this.requireConnection();
    if (!this.advertised.has(topic)) this.send({ op: "advertise", topic, type });
    this.advertised.add(topic);
    this.send({ op: "publish", topic, msg });
  }

  /** Call a service, also for its reason where it only says that it did not succeed; reject with a ConnectionError on failure, timeout or loss of the connection. */
  async call<Response>(service: string, args: unknown, timeout_s = 8): Promise<Response & { refusal: string }> {
    this.requireConnection();
    const id = this.newId("call_service", service);
    const answered = this.request(id, service, timeout_s, (message, refusal) => {
      const { result, values } = message;
      if (!result) throw new ConnectionError(`${service}: ${typeof values === "string" ? values : JSON.stringify(values ?? "")}`);
      return { ...(values as Response), refusal: refusal.replace(/^call_service: service \S+: /, "") };
    });
    this.send({ op: "call_service", id, service, args });
    return answered;
  }

  /** Send a goal to an action; its result rejects with a ConnectionError when the connection is lost. */
  goal<Result>(action: string, action_type: string, args: unknown): GoalHandle<Result> {
    this.requireConnection();
    const id = this.newId("send_action_goal", action);
    const result = this.request(id, action, Infinity, ({ status, values }): GoalResult<Result> => {
      const readable = typeof values === "object" && values !== null;
      return { status, values: readable ? (values as Result) : null, reason: readable ? "" : String(values ?? "") };
    });
    this.send({ op: "send_action_goal", id, action, action_type, args, feedback: false });
    return { result, cancel: () => this.waiting.has(id) && this.send({ op: "cancel_action_goal", id, action }) };
  }

  private newId(op: string, name: string): string {
    this.number += 1;
    return `${op}:${name}:${this.number}`;
  }

  private send(operation: object): void {
    this.socket?.send(JSON.stringify(operation));
  }

  private requireConnection(): void {
    if (this.connected) return;
    throw new ConnectionError(this.refused ? t("request.token", { reason: this.refused }) : t("request.offline"));
  }

  /** Return what is read from an answer; reject as well when the connection is lost, and after a timeout. */
  private async request<Value>(id: string, name: string, timeout_s: number, read: (answer: Operation, refusal: string) => Value): Promise<Value> {
    let timer: ReturnType<typeof setTimeout> | undefined;
    try {
      return await new Promise((resolve, reject) => {
        const fail = (reason: string): void => reject(new ConnectionError(`${name}: ${reason}`));
        const waiting: Waiting = {
          refusal: "",
          answer: (answer) => resolve(answer),
          lost: () => fail(t("request.lost")),
        };
        this.waiting.set(id, waiting);
        if (Number.isFinite(timeout_s)) timer = setTimeout(() => fail(t("request.late", { seconds: timeout_s })), timeout_s * 1000);
      }).then((answer) => read(answer as Operation, this.waiting.get(id)?.refusal ?? ""));
    } finally {
      clearTimeout(timer);
      this.waiting.delete(id);
    }
  }

  private connect(): void {
    clearTimeout(this.reconnect_timer);
    this.refused = "";
    this.accepted = false;
    const socket = new WebSocket(this.url);
    this.socket = socket;
    socket.onopen = () => this.handleOpen();
    socket.onclose = ({ code, reason }) => this.handleClose(code, reason);
    socket.onmessage = ({ data }) => this.handleOperation(JSON.parse(data as string) as Operation);
  }

  private handleOpen(): void {
    this.connected = true;
    this.failures = 0;
    const token = this.token();
    if (token !== null) this.send({ op: "auth", token });
    this.send({ op: "set_level", level: "error" });
    for (const subscription of this.subscriptions) this.sendSubscription(subscription);
    this.onStatus({ connected: true, latency_ms: null, refused: "" });
    this.startHeartbeats();
  }

  private sendSubscription({ id, topic, type, throttle_ms, queue_length }: Subscription): void {
    this.send({ op: "subscribe", id, topic, type, throttle_rate: throttle_ms, queue_length });
  }

  private handleOperation(operation: Operation): void {
    this.silent_heartbeats = 0;
    const { op, id = "", topic, msg } = operation;
    if (op === "publish") {
      for (const subscription of [...this.subscriptions]) if (subscription.topic === topic) deliver(subscription, msg);
      return;
    }
    const waiting = this.waiting.get(id);
    if (waiting === undefined) return;
    if (op === "status") waiting.refusal = String(msg);
    else if (op === "service_response" || op === "action_result") waiting.answer(operation);
  }

  private startHeartbeats(): void {
    clearInterval(this.heartbeat_timer);
    this.silent_heartbeats = 0;
    this.heartbeat_timer = setInterval(() => this.beat(), HEARTBEAT_MS);
    this.beat();
  }

  /** Measure the round trip, which also finds a server that no longer answers. */
  private beat(): void {
    if (this.silent_heartbeats >= SILENT_HEARTBEATS) return this.reconnectLater();
    this.silent_heartbeats += 1;
    const sent_ms = performance.now();
    this.call("/rosapi/get_time", {}).then(
      () => {
        this.accepted = true;
        this.onStatus({ connected: true, latency_ms: performance.now() - sent_ms, refused: "" });
      },
      () => undefined,
    );
  }

  private handleClose(code: number, reason: string): void {
    if (code !== POLICY_VIOLATION || this.accepted) return this.reconnectLater();
    // The server throttles clients that repeat a wrong token, so the page waits for another one.
    this.disconnect();
    this.refused = reason || t("request.token.no_reason");
    this.onStatus({ connected: false, latency_ms: null, refused: this.refused });
  }

  private reconnectLater(): void {
    this.disconnect();
    this.failures += 1;
    this.reconnect_timer = setTimeout(() => this.connect(), backoff_s(this.failures) * 1000);
  }

  private disconnect(): void {
    clearTimeout(this.reconnect_timer);
    clearInterval(this.heartbeat_timer);
    const { socket, connected: was_connected } = this;
    this.socket = null;
    this.connected = false;
    this.advertised.clear();
    for (const { lost } of [...this.waiting.values()]) lost();
    if (socket !== null) {
      // Closing a dead connection may take minutes: do not wait for it, and ignore late messages.
      socket.onopen = socket.onclose = socket.onmessage = null;
      socket.close();
    }
    if (was_connected) this.onStatus({ connected: false, latency_ms: null, refused: "" });
  }

  private retryNow(): void {
    if (document.visibilityState === "hidden") return;
    if (this.connected) this.startHeartbeats();
    else if (!this.socket && !this.refused) this.connect();
  }
}

/** Call a service that answers as a Trigger; a call that fails is an answer without success. */
export async function ask<Response extends Answer>(
  connection: Pick<Connection, "call">,
  service: string,
  request: object,
  timeout_s?: number,
): Promise<Partial<Response> & Answer> {
  try {
    return await connection.call<Response>(service, request, timeout_s);
  } catch (error) {
    return { success: false, message: (error as Error).message } as Partial<Response> & Answer;
  }
}

/** Return the names that a service lists; null from a server that is gone, or of a version without the service. */
export async function askNames(connection: Pick<Connection, "call">, service: string): Promise<string[] | null> {
  return connection.call<{ names: string[] }>(service, {}, WHILE_CONNECTED_S).then(({ names }) => names, () => null);
}

interface Answer {
  success: boolean;
  message: string;
}

/** Deliver a message; the error of one listener is reported, and keeps nothing from the others. */
function deliver({ listener }: Subscription, message: unknown): void {
  try {
    listener(message as never);
  } catch (error) {
    reportError(error);
  }
}
