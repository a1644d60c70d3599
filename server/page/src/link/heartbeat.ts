/** Seconds between two questions, and how long an answer may take before the link counts as lost. */
const PERIOD_S = 2;
const PATIENCE_S = 4;

/** Measures the way to the server and back, and notices a server that has fallen silent. */
export class Heartbeat {
  private timer: ReturnType<typeof setTimeout> | undefined;
  private patience: ReturnType<typeof setTimeout> | undefined;

  /**
   * @param ask - asks the server anything small.
   * @param onLatency - called with the time of each answer [ms].
   * @param onSilence - called when an answer does not come.
   */
  constructor(
    private readonly ask: () => Promise<unknown>,
    private readonly onLatency: (latency_ms: number) => void,
    private readonly onSilence: () => void,
  ) {}

  /** Begin to ask. */
  start(): void {
    this.stop();
    this.beatNow();
  }

  /** Ask no more. */
  stop(): void {
    clearTimeout(this.timer);
    clearTimeout(this.patience);
  }

  /** Ask at once, as after a sleep of the device. */
  beatNow(): void {
    this.stop();
    const asked_ms = performance.now();
    this.patience = setTimeout(this.onSilence, PATIENCE_S * 1000);
    this.ask().then(
      () => this.answered(performance.now() - asked_ms),
      () => undefined,
    );
  }

  private answered(latency_ms: number): void {
    this.stop();
    this.onLatency(latency_ms);
    this.timer = setTimeout(() => this.beatNow(), PERIOD_S * 1000);
  }
}
