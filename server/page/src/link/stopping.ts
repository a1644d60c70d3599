import type { State } from "../state/state";
import type { Store } from "../state/store";
import type { Link } from "./link";
import type { Trigger } from "./wire";

/** The server answers within 6 s, when the arm stands. */
const PATIENCE_S = 7;

/** How long the answer stays on the button [ms]. */
const SHOWN_MS = 4000;

/** Stops the arm, and tells whether the server has acknowledged it. */
export class Stopping {
  private presses = 0;

  /**
   * @param link - to the server.
   * @param store - where the answer goes.
   * @param cancel - cancels a plan that this page waits for.
   */
  constructor(
    private readonly link: Link,
    private readonly store: Store<State>,
    private readonly cancel: () => void,
  ) {}

  /** Stop: as a message, which is the fastest, and as a call, which is answered. */
  async stop(): Promise<void> {
    this.presses += 1;
    const press = this.presses;
    this.store.set({ stop: { phase: "asked", text: "stopping…" } });
    const stop = await this.ask();
    // A press that came later tells for itself.
    if (press !== this.presses) return;
    this.store.set({ stop });
    if (stop.phase === "acknowledged") setTimeout(() => this.ready(press), SHOWN_MS);
  }

  private async ask(): Promise<State["stop"]> {
    try {
      this.link.publish("/stop", "std_msgs/Empty", {});
      this.cancel();
      const { success, message } = await this.link.call<Trigger>("/arm/stop", {}, PATIENCE_S);
      if (success) return { phase: "acknowledged", text: `stopped, acknowledged: ${message || "the arm stands"}` };
      return { phase: "failed", text: `not stopped: ${message}` };
    } catch (error) {
      const why = (error as Error).message;
      return { phase: "failed", text: `not acknowledged: ${why}. The arm's power switch always stops it.` };
    }
  }

  private ready(press: number): void {
    if (press === this.presses) this.store.set({ stop: { phase: "ready", text: "" } });
  }
}
