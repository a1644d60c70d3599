import { armJoints } from "../logic/joints";
import { denialReason } from "../logic/permissions";
import type { JointValues } from "../state/state";
import { permissionFieldset, type PanelContext } from "./context";
import { el, section } from "./dom";

/** Keys of the joints in their order: a digit raises the joint, the key below it lowers it. */
const UP = [..."1234567890"].map((digit) => `Digit${digit}`).concat("Minus", "Equal");
const DOWN = [..."QWERTYUIOP"].map((letter) => `Key${letter}`).concat("BracketLeft", "BracketRight");

/** Keys without a digit or letter, as an English keyboard prints them. */
const PRINTED: Record<string, string> = { Minus: "-", Equal: "=", BracketLeft: "[", BracketRight: "]" };

/** Return the names of a joint's keys; dashes for a joint without. */
export function keyNames(index: number): string {
  const printed = (code: string | undefined): string => (code === undefined ? "–" : (PRINTED[code] ?? code.slice(-1)));
  return `${printed(UP[index])} / ${printed(DOWN[index])}`;
}

/** Return true for a key of one of so many joints. */
export function isJogKey(code: string, joints: number): boolean {
  return [UP, DOWN].some((keys) => keys.slice(0, joints).includes(code));
}

/** Return the velocities of the held keys, as fractions of the joint speed; both keys of a joint cancel out. */
export function jogVelocities(held: ReadonlySet<string>, joints: readonly string[], share: number): JointValues {
  const pairs = joints.map((name, index) => {
    const up = held.has(UP[index] ?? "") ? share : 0;
    const down = held.has(DOWN[index] ?? "") ? share : 0;
    return [name, up - down] as const;
  });
  return Object.fromEntries(pairs.filter(([, velocity]) => velocity !== 0));
}

/** Period of jog commands [ms]: the server stops 250 ms after the last one, and four in that time survive a loss. */
const REPEAT_MS = 60;

/** Create the section of the keyboard jog, which is off until the user switches it on. */
export function jogSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const on = el("input", { type: "checkbox", testid: "jog" });
  const attributes = { min: "0.1", max: "1", step: "0.1" };
  const share = el("input", { type: "range", testid: "jog-speed", label: "speed of the keys", attributes });
  share.value = "0.5";
  const keys = el("dl", { class: "keys" });
  store.subscribe(
    (state) => armJoints(state).join(),
    (_, state) => keys.replaceChildren(...armJoints(state).map(keyLine)),
  );
  listenForKeys(context, () => on.checked, () => Number(share.value));
  const permission = permissionFieldset(context, "drive", on);
  const switch_line = el("label", { class: "line" }, permission, "Move joints by keys while they are held");
  const speed_line = el("label", { class: "line" }, "Speed ", share);
  return section("jog", "Keyboard jog", false, switch_line, speed_line, keys);
}

function keyLine(name: string, index: number): HTMLElement {
  return el("div", {}, el("dt", { text: name }), el("dd", { text: keyNames(index) }));
}

function listenForKeys(context: PanelContext, isOn: () => boolean, share: () => number): void {
  const { store } = context;
  const jogger = new Jogger(context, isOn, share);
  window.addEventListener("keydown", (event) => {
    if (event.key === "Escape") return jogger.releaseAll();
    if (!isOn() || isTyping(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
    if (!isJogKey(event.code, armJoints(store.state).length)) return;
    event.preventDefault();
    if (!event.repeat) jogger.press(event.code);
  });
  window.addEventListener("keyup", (event) => jogger.releaseKey(event.code));
  // The release of a key in another window is not reported to this one.
  window.addEventListener("blur", () => jogger.releaseAll());
  document.addEventListener("visibilitychange", () => jogger.releaseAll());
}

/** Sender of jog commands while keys are held. */
class Jogger {
  private readonly held = new Set<string>();
  private timer: ReturnType<typeof setInterval> | undefined;

  constructor(
    private readonly context: PanelContext,
    private readonly isOn: () => boolean,
    private readonly share: () => number,
  ) {}

  press(code: string): void {
    this.held.add(code);
    this.send();
    this.timer ??= setInterval(() => this.send(), REPEAT_MS);
  }

  releaseKey(code: string): void {
    this.held.delete(code);
    if (this.held.size === 0) this.releaseAll();
  }

  releaseAll(): void {
    this.held.clear();
    clearInterval(this.timer);
    this.timer = undefined;
  }

  private send(): void {
    const { store, commands } = this.context;
    if (!this.isOn() || !store.state.link.connected || denialReason("drive", store.state)) return this.releaseAll();
    const velocities = jogVelocities(this.held, armJoints(store.state), this.share());
    if (Object.keys(velocities).length > 0) commands.jog(velocities);
  }
}

function isTyping(target: EventTarget | null): boolean {
  return target instanceof HTMLInputElement && target.type === "text";
}
