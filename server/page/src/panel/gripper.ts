import { gripperJoint, limitsOf, present } from "../logic/joint-names";
import { angleText, unitSign } from "../logic/units";
import { paced } from "../state/pace";
import type { State } from "../state/state";
import { button, el, section, write } from "./dom";
import { gated } from "./gate";
import type { Page } from "./page";

/** The gripper: a slider that moves it when it is let go of, and buttons for its ends. */
export function gripper(page: Page): HTMLElement {
  const { store, orders } = page;
  const ends = (): [number, number] => limitsOf(store.state)[gripperJoint(store.state) ?? ""] ?? [0, 1];
  const attributes = { min: "0", max: "1", step: "0.001" };
  const slider = el("input", { type: "range", testid: "gripper", label: "gripper, closed to open", attributes });
  const measured = el("output", { testid: "gripper-measured" });
  slider.addEventListener("change", () => void orders.moveGripper(Number(slider.value)));
  const open = button("Open", "gripper-open", () => void orders.moveGripper(ends()[1]));
  const close = button("Close", "gripper-close", () => void orders.moveGripper(ends()[0]));
  const line = el("div", { class: "line" }, close, slider, open, measured);
  const box = section("gripper", "Gripper", true, gated(page, "drive", line));
  const show = paced<State>(100, (state) => {
    const joint = gripperJoint(state);
    box.hidden = joint === null;
    if (joint === null) return;
    const [lower, upper] = ends();
    slider.min = String(lower);
    slider.max = String(upper);
    const value_rad = present(state)[joint] ?? Number.NaN;
    if (Number.isFinite(value_rad) && !slider.matches(":active, :focus")) slider.value = String(value_rad);
    write(measured, `${angleText(value_rad, state.settings.units)}${unitSign(state.settings.units)}`);
  });
  for (const part of ["joints", "limits", "named", "settings"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  return box;
}
