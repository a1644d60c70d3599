import type { JogCommand, TipAxis } from "../logic/jog";
import { t } from "../texts/texts";
import { el, loadPreference, option, storePreference } from "./dom";

/** What a press of any input of this panel does: the chosen speed, and the chosen step. */
export interface JogControls {
  /** Share of the full speed, 0 to 1. */
  share: () => number;
  /** Begin what a press does: one step, or motion until the release. */
  press: (input: string, command: JogCommand) => void;
  /** Make one step, the smallest while presses are held: for a press without a release. */
  step: (input: string, command: JogCommand) => void;
  release: (input: string) => void;
}

/** Return the text of an axis. */
export function axisText(axis: TipAxis): string {
  return t(`drive.axis.${axis}`);
}

/** Create a choice that the browser stores. */
export function choice(
  testid: string,
  label: string,
  values: readonly string[],
  texts: readonly string[],
  take: (value: string) => void = () => undefined,
): HTMLSelectElement {
  const options = values.map((value, index) => option(value, texts[index] ?? value));
  const select = el("select", { testid, label }, ...options);
  const stored = loadPreference(testid, "");
  if (values.includes(stored)) select.value = stored;
  take(select.value);
  select.addEventListener("change", () => {
    storePreference(testid, select.value);
    take(select.value);
  });
  return select;
}

/** Ends of a press. The window hears them also of an element that is gone or disabled by then. */
const ENDS = ["pointerup", "pointercancel", "lostpointercapture"] as const;

/** Report the press and the release of a button by a pointer, or by Space or Enter while it has the focus. */
export function watchHold(element: HTMLElement, press: () => void, release: () => void): void {
  watchPointer(element, press, release);
  let by_key = false;
  const end = (): void => {
    if (by_key) release();
    by_key = false;
  };
  element.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (event.repeat) return;
    by_key = true;
    press();
  });
  element.addEventListener("keyup", ({ key }) => (key === " " || key === "Enter") && end());
  element.addEventListener("blur", end);
}

/** Report the press and the release of an element by one pointer, which may leave the element and outlive it. */
export function watchPointer(
  element: HTMLElement,
  press: (event: PointerEvent) => void,
  release: () => void,
  move: (event: PointerEvent) => void = () => undefined,
): void {
  let held: number | null = null;
  element.addEventListener("pointerdown", (event) => {
    if (held !== null || (event.pointerType === "mouse" && event.button !== 0)) return;
    held = event.pointerId;
    element.setPointerCapture(event.pointerId);
    element.dataset["held"] = "true";
    for (const name of ENDS) window.addEventListener(name, end, { capture: true });
    press(event);
  });
  const end = ({ pointerId }: PointerEvent): void => {
    if (pointerId !== held) return;
    held = null;
    delete element.dataset["held"];
    for (const name of ENDS) window.removeEventListener(name, end, { capture: true });
    release();
  };
  element.addEventListener("pointermove", (event) => event.pointerId === held && move(event));
  // A long press would open the menu in place of moving the arm.
  element.addEventListener("contextmenu", (event) => event.preventDefault());
}
