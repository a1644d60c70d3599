import { duration_s } from "../logic/trajectory";
import type { State } from "../state/state";
import type { Store } from "../state/store";
import { button, el, write } from "./dom";
import type { Page } from "./page";

/** Shows the ghost anywhere on the planned path, and replays it. */
export function scrubber({ store }: Page): HTMLElement {
  const attributes = { min: "0", max: "0", step: "0.01" };
  const slider = el("input", { type: "range", testid: "scrubber", label: "time on the planned motion", attributes });
  const text = el("output", { testid: "scrubber-text" });
  const replay = new Replay(store, (playing) => write(play, playing ? "❚❚ Halt" : "▶ Replay"));
  const play = button("▶ Replay", "replay", () => replay.toggle());
  slider.addEventListener("input", () => {
    replay.end();
    store.patch("plan", { scrub_s: Number(slider.value) });
  });
  const box = el("div", { class: "scrubber" }, play, slider, text);
  store.subscribe(
    (state) => state.plan,
    ({ trajectory, scrub_s }) => {
      box.hidden = trajectory === null;
      if (!trajectory) return;
      const end_s = duration_s(trajectory);
      slider.max = String(end_s);
      slider.value = String(scrub_s ?? end_s);
      write(text, `${(scrub_s ?? end_s).toFixed(2)} of ${end_s.toFixed(2)} s`);
    },
  );
  return box;
}

/** Moves the ghost along the plan in the time that the motion will take. */
class Replay {
  private began_ms: number | null = null;

  constructor(
    private readonly store: Store<State>,
    private readonly onChange: (playing: boolean) => void,
  ) {}

  toggle(): void {
    if (this.began_ms !== null) return this.end();
    this.began_ms = performance.now();
    this.onChange(true);
    this.step();
  }

  end(): void {
    this.began_ms = null;
    this.onChange(false);
  }

  private step(): void {
    const { trajectory } = this.store.state.plan;
    if (this.began_ms === null) return;
    if (!trajectory) return this.end();
    const now_s = (performance.now() - this.began_ms) / 1000;
    const end_s = duration_s(trajectory);
    this.store.patch("plan", { scrub_s: Math.min(now_s, end_s) });
    if (now_s >= end_s) this.end();
    else requestAnimationFrame(() => this.step());
  }
}
