import { isJogKey, jogVelocities, keyWords } from "../logic/jog-keys";
import { armJoints } from "../logic/joint-names";
import { hindrance } from "../logic/rights";
import { el, section } from "./dom";
import { gated } from "./gate";
import type { Page } from "./page";

/** The server brakes the arm 250 ms after the last command; four commands in that time survive a lost one [ms]. */
const REPEAT_MS = 60;

/** Keys that turn joints while they are held; off until somebody switches them on. */
export function jog(page: Page): HTMLElement {
  const { store } = page;
  const on = el("input", { type: "checkbox", testid: "jog" });
  const attributes = { min: "0.1", max: "1", step: "0.1" };
  const share = el("input", { type: "range", testid: "jog-speed", label: "speed of the keys", attributes });
  share.value = "0.5";
  const keys = el("dl", { class: "keys" });
  store.subscribe(
    (state) => armJoints(state).join(),
    (_, state) => keys.replaceChildren(...armJoints(state).map(keyLine)),
  );
  holdKeys(page, () => on.checked, () => Number(share.value));
  const line = el("label", { class: "line" }, gated(page, "drive", on), "Turn joints by keys while they are held");
  return section("jog", "Keyboard jog", false, line, el("label", { class: "line" }, "Speed ", share), keys);
}

function keyLine(name: string, index: number): HTMLElement {
  return el("div", {}, el("dt", { text: name }), el("dd", { text: keyWords(index) }));
}

function holdKeys(page: Page, isOn: () => boolean, share: () => number): void {
  const { store } = page;
  const jogger = new Jogger(page, isOn, share);
  window.addEventListener("keydown", (event) => {
    if (event.key === "Escape") return jogger.release();
    if (!isOn() || isTyping(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
    if (!isJogKey(event.code, armJoints(store.state).length)) return;
    event.preventDefault();
    if (!event.repeat) jogger.press(event.code);
  });
  window.addEventListener("keyup", (event) => jogger.letGo(event.code));
  // A key that is let go of in another window is never told here.
  window.addEventListener("blur", () => jogger.release());
  document.addEventListener("visibilitychange", () => jogger.release());
}

/** Sends commands as long as keys are held. */
class Jogger {
  private readonly held = new Set<string>();
  private timer: ReturnType<typeof setInterval> | undefined;

  constructor(
    private readonly page: Page,
    private readonly isOn: () => boolean,
    private readonly share: () => number,
  ) {}

  press(code: string): void {
    this.held.add(code);
    this.send();
    this.timer ??= setInterval(() => this.send(), REPEAT_MS);
  }

  letGo(code: string): void {
    this.held.delete(code);
    if (this.held.size === 0) this.release();
  }

  release(): void {
    this.held.clear();
    clearInterval(this.timer);
    this.timer = undefined;
  }

  private send(): void {
    const { store, orders } = this.page;
    if (!this.isOn() || !store.state.link.connected || hindrance("drive", store.state)) return this.release();
    const velocities = jogVelocities(this.held, armJoints(store.state), this.share());
    if (Object.keys(velocities).length > 0) orders.jog(velocities);
  }
}

function isTyping(target: EventTarget | null): boolean {
  return target instanceof HTMLInputElement && target.type === "text";
}
