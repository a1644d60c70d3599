import { Ros, Topic } from "roslib";
import { t } from "../texts/texts";

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

/** Seconds from an answer to the next heartbeat, and from a heartbeat to the loss of the connection. */
const HEARTBEAT_PERIOD_S = 2;
const HEARTBEAT_TIMEOUT_S = 4;

/** Measure of the round trip, which also detects a server that no longer answers. */
export class Heartbeat {
  private timer: ReturnType<typeof setTimeout> | undefined;
  private timeout: ReturnType<typeof setTimeout> | undefined;

  /**
   * @param send - sends the server any small request.
   * @param onLatency - called with the round-trip time of each answer [ms].
   * @param onTimeout - called when an answer does not come in time.
   */
  constructor(
    private readonly send: () => Promise<unknown>,
    private readonly onLatency: (latency_ms: number) => void,
    private readonly onTimeout: () => void,
  ) {}

  /** Start sending. */
  start(): void {
    this.stop();
    this.sendNow();
  }

  /** Stop sending. */
  stop(): void {
    clearTimeout(this.timer);
    clearTimeout(this.timeout);
  }

  /** Send at once, as after a sleep of the device. */
  sendNow(): void {
    this.stop();
    const sent_ms = performance.now();
    this.timeout = setTimeout(this.onTimeout, HEARTBEAT_TIMEOUT_S * 1000);
    this.send().then(
      () => this.handleAnswer(performance.now() - sent_ms),
      () => undefined,
    );
  }

  private handleAnswer(latency_ms: number): void {
    this.stop();
    this.onLatency(latency_ms);
    this.timer = setTimeout(() => this.sendNow(), HEARTBEAT_PERIOD_S * 1000);
  }
}

/** action_msgs/GoalStatus.STATUS_ABORTED. */
export const STATUS_ABORTED = 6;

/** Goal that was sent to an action. */
export interface GoalHandle<Result> {
  /** Final status of action_msgs/GoalStatus, with the result, or with the reason where the goal was rejected. */
  result: Promise<{ status: number; values: Result | null; reason: string }>;
  /** Ask the server to cancel it. */
  cancel: () => void;
}

interface ActionResult {
  op: string;
  status: number;
  result: boolean;
  values: unknown;
}

/** Number of the last call or goal, by which its answer is known. */
let sent_requests = 0;

/** Send a goal by rosbridge's own operations, as roslib's Action turns the result of a failed goal into a text. */
export function sendActionGoal<Result>(ros: Ros, action: string, type: string, goal: unknown): GoalHandle<Result> {
  sent_requests += 1;
  const id = `send_action_goal:${action}:${sent_requests}`;
  const result = new Promise<Awaited<GoalHandle<Result>["result"]>>((resolve) => {
    const onMessage = (message: unknown): void => {
      const answer = message as ActionResult;
      if (answer.op !== "action_result") return;
      ros.off(id, onMessage);
      const readable = typeof answer.values === "object" && answer.values !== null;
      const values = readable ? (answer.values as Result) : null;
      resolve({ status: answer.status, values, reason: readable ? "" : String(answer.values ?? "") });
    };
    ros.on(id, onMessage);
  });
  ros.callOnConnection({ op: "send_action_goal", id, action, action_type: type, args: goal, feedback: false });
  const cancel = (): void => {
    if (ros.isConnected) ros.callOnConnection({ op: "cancel_action_goal", id, action });
  };
  return { result, cancel };
}

/** Reason of a response that says only that the service has not succeeded; empty for others. */
export interface Refusable {
  refusal: string;
}

/** Call a service by rosbridge's own operations: roslib does not tell the id, by which the server's status names the reason. */
function callService<Response>(
  ros: Ros,
  service: string,
  args: unknown,
  resolve: (response: Response & Refusable) => void,
  reject: (reason: string) => void,
): void {
  sent_requests += 1;
  const id = `call_service:${service}:${sent_requests}`;
  let refusal = "";
  // The status comes before the response (docs/protocol.md, "Status").
  const onStatus = (status: unknown): void => {
    refusal = (status as { msg: string }).msg.replace(/^call_service: service \S+: /, "");
  };
  ros.on(`status:${id}`, onStatus);
  ros.once(id, (message) => {
    ros.off(`status:${id}`, onStatus);
    const { result, values } = message as unknown as { result: boolean; values: Response };
    if (result) resolve({ ...values, refusal });
    else reject(toText(values ?? ""));
  });
  ros.callOnConnection({ op: "call_service", id, service, args });
}

/** Condition of the connection. */
export interface ConnectionStatus {
  connected: boolean;
  latency_ms: number | null;
  /** Server's reason for rejecting the page; empty when it accepts it, or cannot be reached. */
  refused: string;
}

/** Close code of RFC 6455, section 7.4.1, for a connection without a valid token. */
const POLICY_VIOLATION = 1008;

interface Subscription {
  topic: string;
  type: string;
  throttle_ms: number;
  listener: (message: never) => void;
  /** Subscriber of the present connection. */
  subscriber: Topic | null;
}

/** rosbridge connection that reconnects by itself and restores its subscriptions. */
export class Connection {
  private ros: Ros | null = null;
  private connected = false;
  /** True once the server has answered a request of this connection. */
  private accepted = false;
  private refused = "";
  private failures = 0;
  private reconnect_timer: ReturnType<typeof setTimeout> | undefined;
  private readonly subscriptions = new Set<Subscription>();
  private readonly publishers = new Map<string, Topic>();
  private readonly disconnect_listeners = new Set<() => void>();
  private readonly heartbeat: Heartbeat;

  /**
   * @param url - WebSocket address of the server.
   * @param onStatus - called whenever the connection opens or closes, and with every latency.
   * @param token - returns the token to send; null for none.
   */
  constructor(
    readonly url: string,
    private readonly onStatus: (status: ConnectionStatus) => void,
    private readonly token: () => string | null = () => null,
  ) {
    this.heartbeat = new Heartbeat(
      () => this.call("/rosapi/get_time", {}),
      (latency_ms) => this.handleHeartbeat(latency_ms),
      () => this.reconnectLater(this.ros),
    );
  }

  /** Connect, and stay connected. */
  open(): void {
    const retryNow = (): void => this.retryNow();
    window.addEventListener("online", retryNow);
    document.addEventListener("visibilitychange", retryNow);
    this.connect();
  }

  /** Connect anew with the present token. */
  reopen(): void {
    this.disconnect();
    this.onStatus({ connected: false, latency_ms: null, refused: "" });
    this.connect();
  }

  /** True while the connection is open. */
  get isConnected(): boolean {
    return this.connected;
  }

  /**
   * Subscribe to a topic, now and after every reconnection.
   *
   * @param throttle_ms - least time between two messages; the newest is kept.
   * @returns function that ends the subscription.
   */
  subscribe<Message>(topic: string, type: string, listener: (message: Message) => void, throttle_ms = 0): () => void {
    const subscription: Subscription = { topic, type, throttle_ms, listener, subscriber: null };
    this.subscriptions.add(subscription);
    if (this.connected && this.ros) subscribeTopic(this.ros, subscription);
    return () => {
      this.subscriptions.delete(subscription);
      if (this.connected) subscription.subscriber?.unsubscribe();
    };
  }

  /** Publish a message; throw a ConnectionError while there is no connection. */
  publish(topic: string, type: string, message: unknown): void {
    const ros = this.requireRos();
    let publisher = this.publishers.get(topic);
    if (!publisher) {
      publisher = new Topic({ ros, name: topic, messageType: type, reconnect_on_close: false });
      this.publishers.set(topic, publisher);
    }
    publisher.publish(message);
  }

  /** Call a service; reject with a ConnectionError on failure, timeout or loss of the connection. */
  async call<Response>(service: string, request: unknown, timeout_s = 8): Promise<Response & Refusable> {
    const ros = this.requireRos();
    return this.awaitAnswer(service, timeout_s, (resolve, reject) => {
      callService<Response>(ros, service, request, resolve, (reason) => reject(new ConnectionError(`${service}: ${reason}`)));
    });
  }

  /** Send a goal to an action; its result rejects with a ConnectionError when the connection is lost. */
  goal<Result>(action: string, type: string, goal: unknown): GoalHandle<Result> {
    const ros = this.requireRos();
    const handle = sendActionGoal<Result>(ros, action, type, goal);
    const result = this.awaitAnswer<Awaited<GoalHandle<Result>["result"]>>(action, Infinity, (resolve, reject) => {
      handle.result.then(resolve, reject);
    });
    return { ...handle, result };
  }

  private requireRos(): Ros {
    if (this.ros && this.connected) return this.ros;
    if (this.refused) throw new ConnectionError(t("request.token", { reason: this.refused }));
    throw new ConnectionError(t("request.offline"));
  }

  /** Return a promise that also rejects when the connection is lost, and after a timeout. */
  private awaitAnswer<Value>(
    request: string,
    timeout_s: number,
    begin: (resolve: (value: Value) => void, reject: (reason: Error) => void) => void,
  ): Promise<Value> {
    return new Promise((resolve, reject) => {
      const fail = (reason: string): void => end(() => reject(new ConnectionError(`${request}: ${reason}`)));
      const lost = (): void => fail(t("request.lost"));
      const late = (): void => fail(t("request.late", { seconds: timeout_s }));
      const timer = Number.isFinite(timeout_s) ? setTimeout(late, timeout_s * 1000) : undefined;
      const end = (then: () => void): void => {
        clearTimeout(timer);
        this.disconnect_listeners.delete(lost);
        then();
      };
      this.disconnect_listeners.add(lost);
      begin(
        (value) => end(() => resolve(value)),
        (reason) => end(() => reject(reason)),
      );
    });
  }

  private connect(): void {
    clearTimeout(this.reconnect_timer);
    this.refused = "";
    this.accepted = false;
    // A new Ros each time: the old one would still send its unsent messages, perhaps a motion that is no longer wanted.
    const ros = new Ros();
    this.ros = ros;
    ros.on("connection", () => this.handleOpen(ros));
    ros.on("close", (event) => this.handleClose(ros, event as unknown as Partial<CloseEvent>));
    ros.on("error", () => undefined);
    ros.connect(this.url).catch(() => this.reconnectLater(ros));
  }

  private handleOpen(ros: Ros): void {
    if (ros !== this.ros) return ros.close();
    this.connected = true;
    this.failures = 0;
    const token = this.token();
    if (token !== null) ros.callOnConnection({ op: "auth", token } as never);
    ros.callOnConnection({ op: "set_level", level: "error" } as never);
    for (const subscription of this.subscriptions) subscribeTopic(ros, subscription);
    this.onStatus({ connected: true, latency_ms: null, refused: "" });
    this.heartbeat.start();
  }

  private handleHeartbeat(latency_ms: number): void {
    this.accepted = true;
    this.onStatus({ connected: true, latency_ms, refused: "" });
  }

  private handleClose(ros: Ros, { code, reason }: Partial<CloseEvent>): void {
    if (ros !== this.ros || code !== POLICY_VIOLATION || this.accepted) return this.reconnectLater(ros);
    // The server throttles clients that repeat a wrong token, so the page waits for another one.
    this.disconnect();
    this.refused = reason || t("request.token.no_reason");
    this.onStatus({ connected: false, latency_ms: null, refused: this.refused });
  }

  private reconnectLater(ros: Ros | null): void {
    if (!ros || ros !== this.ros) return;
    this.disconnect();
    this.failures += 1;
    this.reconnect_timer = setTimeout(() => this.connect(), backoff_s(this.failures) * 1000);
  }

  private disconnect(): void {
    clearTimeout(this.reconnect_timer);
    const ros = this.ros;
    this.ros = null;
    const was_connected = this.connected;
    this.connected = false;
    this.heartbeat.stop();
    this.publishers.clear();
    for (const lost of [...this.disconnect_listeners]) lost();
    // Closing a dead connection may take minutes: do not wait for it, and ignore late messages.
    ros?.removeAllListeners();
    ros?.close();
    if (was_connected) this.onStatus({ connected: false, latency_ms: null, refused: "" });
  }

  private retryNow(): void {
    if (document.visibilityState === "hidden") return;
    if (this.connected) this.heartbeat.sendNow();
    else if (!this.ros && !this.refused) this.connect();
  }
}

function subscribeTopic(ros: Ros, subscription: Subscription): void {
  const { topic, type, throttle_ms, listener } = subscription;
  const subscriber = new Topic({
    ros,
    name: topic,
    messageType: type,
    throttle_rate: throttle_ms,
    queue_length: throttle_ms > 0 ? 1 : 0,
    reconnect_on_close: false,
  });
  subscriber.subscribe(listener as (message: unknown) => void);
  subscription.subscriber = subscriber;
}

function toText(reason: unknown): string {
  return typeof reason === "string" ? reason : JSON.stringify(reason);
}
