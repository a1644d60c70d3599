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

/** Report the press and the release of an element by one pointer, which is captured: it may leave the element. */
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
    press(event);
  });
  const end = ({ pointerId }: PointerEvent): void => {
    if (pointerId !== held) return;
    held = null;
    delete element.dataset["held"];
    release();
  };
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) element.addEventListener(name, end);
  element.addEventListener("pointermove", (event) => event.pointerId === held && move(event));
  // A long press would open the menu in place of moving the arm.
  element.addEventListener("contextmenu", (event) => event.preventDefault());
}
