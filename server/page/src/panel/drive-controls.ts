import { createContext, type RefObject } from "preact";
import { useContext, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { JogCommand, TipAxis } from "../logic/jog";
import { loadPreference, storePreference } from "../state/preferences";
import { t } from "../texts/texts";

/** Effect of a press of any input of this panel: the chosen speed, and the chosen step. */
export interface JogControls {
  share: () => number;
  press: (input: string, command: JogCommand) => void;
  /** Make one step, the smallest while presses are held: for a press without a release. */
  step: (command: JogCommand) => void;
  release: (input: string) => void;
}

export const Controls = createContext({} as JogControls);
export const useControls = (): JogControls => useContext(Controls);

export function axisText(axis: TipAxis): string {
  return t(`drive.axis.${axis}`);
}

export function useStored<Value extends string>(key: string, values: readonly Value[]): [Value, (value: string) => void] {
  const [chosen, choose] = useStoredText(key, "");
  return [values.find((each) => each === chosen) ?? (values[0] as Value), choose];
}

export function useStoredNumber(key: string, initial: number): [number, (value: number) => void] {
  const [chosen, choose] = useStoredText(key, String(initial));
  return [Number(chosen), (value) => choose(String(value))];
}

function useStoredText(key: string, initial: string): [string, (text: string) => void] {
  const [chosen, choose] = useState(() => loadPreference(key, initial));
  const change = (text: string): void => {
    storePreference(key, text);
    choose(text);
  };
  return [chosen, change];
}

/** Return a reference to an element whose press and release are reported. */
export function useHold<Element extends HTMLElement>(press: () => void, release: () => void): RefObject<Element | null> {
  const element = useRef<Element>(null);
  const newest = useRef({ press, release });
  newest.current = { press, release };
  useLayoutEffect(() => void (element.current && watchHold(element.current, () => newest.current.press(), () => newest.current.release())), []);
  return element;
}

/** Ends of a press. The window hears them also of an element that is gone or disabled by then. */
const ENDS = ["pointerup", "pointercancel", "lostpointercapture"] as const;

/** Report the press and the release of a button by a pointer, or by Space or Enter while it has the focus. */
function watchHold(element: HTMLElement, press: () => void, release: () => void): void {
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
function watchPointer(
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
    element.dataset.held = "true";
    for (const name of ENDS) window.addEventListener(name, end, { capture: true });
    press(event);
  });
  const end = ({ pointerId }: PointerEvent): void => {
    if (pointerId !== held) return;
    held = null;
    delete element.dataset.held;
    for (const name of ENDS) window.removeEventListener(name, end, { capture: true });
    release();
  };
  element.addEventListener("pointermove", (event) => event.pointerId === held && move(event));
  // A long press would open the menu in place of moving the arm.
  element.addEventListener("contextmenu", (event) => event.preventDefault());
}

/** Report the way of a thumb from where it has landed on an element [px], and its release. */
export function watchThumb(element: HTMLElement, move: (right_px: number, down_px: number) => void, release: () => void, land: (event: PointerEvent) => void = () => undefined): void {
  let landed = { x: 0, y: 0 };
  const press = (event: PointerEvent): void => {
    landed = { x: event.clientX, y: event.clientY };
    land(event);
  };
  watchPointer(element, press, release, ({ clientX, clientY }) => move(clientX - landed.x, clientY - landed.y));
}
