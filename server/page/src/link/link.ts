import { Ros, Service, Topic } from "roslib";
import { backoff_s } from "./backoff";
import { LinkError } from "./errors";
import { sendGoal, type GoalCall } from "./goal-call";
import { Heartbeat } from "./heartbeat";

/** What the link tells of itself. */
export interface LinkNews {
  connected: boolean;
  latency_ms: number | null;
  /** Why the server does not let the page in; empty when it does, or cannot be reached. */
  refused: string;
}

/** RFC 6455 7.4.1: so the server closes a connection that has not shown a token it knows. */
const POLICY_VIOLATION = 1008;

interface Subscription {
  topic: string;
  type: string;
  throttle_ms: number;
  listener: (message: never) => void;
}

/** A rosbridge connection that comes back by itself, with everything that was subscribed. */
export class Link {
  private ros: Ros | null = null;
  private connected = false;
  /** Whether the server has answered anything since it was connected. */
  private welcome = false;
  private refused = "";
  private failures = 0;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private readonly subscriptions: Subscription[] = [];
  private readonly publishers = new Map<string, Topic>();
  private readonly losses = new Set<() => void>();
  private readonly heartbeat: Heartbeat;

  /**
   * @param url - where the server listens.
   * @param onNews - called whenever the link goes up or down, and with every latency.
   * @param token - gives the token to show; null for none.
   */
  constructor(
    readonly url: string,
    private readonly onNews: (news: LinkNews) => void,
    private readonly token: () => string | null = () => null,
  ) {
    this.heartbeat = new Heartbeat(
      () => this.call("/rosapi/get_time", {}),
      (latency_ms) => this.answered(latency_ms),
      () => this.lose(this.ros),
    );
  }

  /** Connect, and stay connected. */
  open(): void {
    const retryNow = (): void => this.retryNow();
    window.addEventListener("online", retryNow);
    document.addEventListener("visibilitychange", retryNow);
    this.connect();
  }

  /** Connect anew, with the token of the moment. */
  reopen(): void {
    this.drop();
    this.onNews({ connected: false, latency_ms: null, refused: "" });
    this.connect();
  }

  /** Whether the server can be asked now. */
  get isConnected(): boolean {
    return this.connected;
  }

  /**
   * Hear a topic, now and after every reconnection.
   *
   * @param throttle_ms - least time between two messages; the newest is kept.
   */
  subscribe<Message>(topic: string, type: string, listener: (message: Message) => void, throttle_ms = 0): void {
    const subscription = { topic, type, throttle_ms, listener };
    this.subscriptions.push(subscription);
    if (this.connected && this.ros) listen(this.ros, subscription);
  }

  /** Publish a message; throws a LinkError when nobody would hear it. */
  publish(topic: string, type: string, message: unknown): void {
    const ros = this.needed();
    let publisher = this.publishers.get(topic);
    if (!publisher) {
      publisher = new Topic({ ros, name: topic, messageType: type, reconnect_on_close: false });
      this.publishers.set(topic, publisher);
    }
    publisher.publish(message);
  }

  /** Call a service; rejects with a LinkError when it fails, takes too long, or the link is lost meanwhile. */
  async call<Response>(service: string, request: unknown, timeout_s = 8): Promise<Response> {
    const ros = this.needed();
    const caller = new Service<unknown, Response>({ ros, name: service, serviceType: "" });
    return this.whileUp(service, timeout_s, (resolve, reject) => {
      caller.callService(request, resolve, (reason) => reject(new LinkError(`${service}: ${asText(reason)}`)));
    });
  }

  /** Send a goal to an action; its result rejects with a LinkError when the link is lost. */
  goal<Result>(action: string, type: string, goal: unknown): GoalCall<Result> {
    const ros = this.needed();
    const call = sendGoal<Result>(ros, action, type, goal);
    const result = this.whileUp<Awaited<GoalCall<Result>["result"]>>(action, Infinity, (resolve, reject) => {
      call.result.then(resolve, reject);
    });
    return { ...call, result };
  }

  private needed(): Ros {
    if (this.ros && this.connected) return this.ros;
    throw new LinkError(this.refused ? `the server wants a token: ${this.refused}` : "the server cannot be reached; the page keeps trying");
  }

  /** A promise that ends also when the link does, and after a time. */
  private whileUp<Value>(
    what: string,
    timeout_s: number,
    begin: (resolve: (value: Value) => void, reject: (reason: Error) => void) => void,
  ): Promise<Value> {
    return new Promise((resolve, reject) => {
      const lost = (): void => end(() => reject(new LinkError(`${what}: the connection was lost before the answer`)));
      const late = (): void => end(() => reject(new LinkError(`${what}: no answer within ${timeout_s} s`)));
      const timer = Number.isFinite(timeout_s) ? setTimeout(late, timeout_s * 1000) : undefined;
      const end = (then: () => void): void => {
        clearTimeout(timer);
        this.losses.delete(lost);
        then();
      };
      this.losses.add(lost);
      begin(
        (value) => end(() => resolve(value)),
        (reason) => end(() => reject(reason)),
      );
    });
  }

  private connect(): void {
    clearTimeout(this.retry);
    this.refused = "";
    this.welcome = false;
    // A new one each time: an old one would still send what was left unsent, perhaps a motion nobody wants any more.
    const ros = new Ros();
    this.ros = ros;
    ros.on("connection", () => this.up(ros));
    ros.on("close", (event) => this.closed(ros, event as unknown as Partial<CloseEvent>));
    ros.on("error", () => undefined);
    ros.connect(this.url).catch(() => this.lose(ros));
  }

  private up(ros: Ros): void {
    if (ros !== this.ros) return ros.close();
    this.connected = true;
    this.failures = 0;
    const token = this.token();
    if (token !== null) ros.callOnConnection({ op: "auth", token } as never);
    for (const subscription of this.subscriptions) listen(ros, subscription);
    this.onNews({ connected: true, latency_ms: null, refused: "" });
    this.heartbeat.start();
  }

  private answered(latency_ms: number): void {
    this.welcome = true;
    this.onNews({ connected: true, latency_ms, refused: "" });
  }

  private closed(ros: Ros, { code, reason }: Partial<CloseEvent>): void {
    if (ros !== this.ros || code !== POLICY_VIOLATION || this.welcome) return this.lose(ros);
    // Who tries a wrong token again and again is shut out: it waits for another one.
    this.drop();
    this.refused = reason || "it gave no reason";
    this.onNews({ connected: false, latency_ms: null, refused: this.refused });
  }

  private lose(ros: Ros | null): void {
    if (!ros || ros !== this.ros) return;
    this.drop();
    this.failures += 1;
    this.retry = setTimeout(() => this.connect(), backoff_s(this.failures) * 1000);
  }

  private drop(): void {
    clearTimeout(this.retry);
    const ros = this.ros;
    this.ros = null;
    const wasUp = this.connected;
    this.connected = false;
    this.heartbeat.stop();
    this.publishers.clear();
    for (const lost of [...this.losses]) lost();
    // Closing a dead connection may take minutes: nobody waits for it, and what still comes is not heard.
    ros?.removeAllListeners();
    ros?.close();
    if (wasUp) this.onNews({ connected: false, latency_ms: null, refused: "" });
  }

  private retryNow(): void {
    if (document.visibilityState === "hidden") return;
    if (this.connected) this.heartbeat.beatNow();
    else if (!this.ros && !this.refused) this.connect();
  }
}

function listen(ros: Ros, { topic, type, throttle_ms, listener }: Subscription): void {
  const subscriber = new Topic({
    ros,
    name: topic,
    messageType: type,
    throttle_rate: throttle_ms,
    queue_length: throttle_ms > 0 ? 1 : 0,
    reconnect_on_close: false,
  });
  subscriber.subscribe(listener as (message: unknown) => void);
}

function asText(reason: unknown): string {
  return typeof reason === "string" ? reason : JSON.stringify(reason);
}
