/** Stands in for roslib's connection: opened and lost by the test. */
export class FakeRos {
  static made: FakeRos[] = [];
  readonly sent: Record<string, unknown>[] = [];
  isConnected = false;
  closed = false;
  private readonly listeners = new Map<string, Set<(message: unknown) => void>>();

  constructor() {
    FakeRos.made.push(this);
  }

  /** Hear an event. */
  on(event: string, listener: (message: unknown) => void): void {
    this.listeners.set(event, (this.listeners.get(event) ?? new Set()).add(listener));
  }

  /** Hear an event; the tests send each once. */
  once(event: string, listener: (message: unknown) => void): void {
    this.on(event, listener);
  }

  /** Hear it no more. */
  off(event: string, listener: (message: unknown) => void): void {
    this.listeners.get(event)?.delete(listener);
  }

  /** Hear nothing more. */
  removeAllListeners(): void {
    this.listeners.clear();
  }

  /** Let an event happen. */
  emit(event: string, message: unknown = {}): void {
    for (const listener of [...(this.listeners.get(event) ?? [])]) listener(message);
  }

  /** Note an operation that would be sent. */
  callOnConnection(message: Record<string, unknown>): void {
    this.sent.push(message);
  }

  /** Begin; the test says when it is open. */
  connect(): Promise<void> {
    return Promise.resolve();
  }

  /** Note that it was given up. */
  close(): void {
    this.closed = true;
  }

  /** Be open. */
  up(): void {
    this.isConnected = true;
    this.emit("connection");
  }

  /** The operations of one kind that were sent. */
  ops(op: string): Record<string, unknown>[] {
    return this.sent.filter((message) => message["op"] === op);
  }

  /** Answer the first call of a service. */
  answer(service: string, values: unknown): void {
    const call = this.ops("call_service").find((message) => message["service"] === service);
    this.emit(String(call?.["id"]), { op: "service_response", id: call?.["id"], values, result: true });
  }
}
