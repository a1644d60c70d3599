import { armJoints, limitsOf, present, shownJoints } from "../logic/joint-names";
import { angleStep, angleText, fromUnit, toUnit, unitSign } from "../logic/units";
import { paced } from "../state/pace";
import type { State } from "../state/state";
import { wish } from "../state/wishes";
import { button, el, remember, remembered, section, write } from "./dom";
import { numberField } from "./number-field";
import type { Page } from "./page";

/** Numbers that change faster than this cannot be read [ms]. */
const READABLE_MS = 100;

interface Row {
  name: string;
  box: HTMLElement;
  show: (state: State) => void;
}

/** One row a joint: a slider, a number, where the joint is, and its limits. */
export function joints(page: Page): HTMLElement {
  const { store } = page;
  const list = el("div", { class: "rows", testid: "joints" });
  let rows: Row[] = [];
  const show = paced<State>(READABLE_MS, (state) => {
    const names = armJoints(state);
    if (names.join() !== rows.map(({ name }) => name).join()) {
      rows = names.map((name) => jointRow(page, name));
      list.replaceChildren(...rows.map(({ box }) => box));
    }
    for (const row of rows) row.show(state);
  });
  for (const part of ["joints", "limits", "named", "wish", "target", "settings", "urdf"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const back = button("Back to where the arm is", "forget-wish", () => wish(store, "none", null));
  return section("joints", "Joints", true, unitSwitch(page), list, back);
}

function unitSwitch({ store }: Page): HTMLElement {
  const units = el("select", { testid: "units", id: "units" }, option("deg", "degrees"), option("rad", "radians"));
  units.addEventListener("change", () => {
    const chosen = units.value === "rad" ? "rad" : "deg";
    remember("units", chosen);
    store.patch("settings", { units: chosen });
  });
  store.patch("settings", { units: remembered("units", "deg") === "rad" ? "rad" : "deg" });
  units.value = store.state.settings.units;
  return el("label", { class: "line" }, "Angles in ", units);
}

function option(value: string, text: string): HTMLOptionElement {
  return el("option", { text, attributes: { value } });
}

function jointRow({ store }: Page, name: string): Row {
  const range = (): [number, number] => limitsOf(store.state)[name] ?? [-Math.PI, Math.PI];
  const take = (value_rad: number): void => {
    const base = Object.entries(shownJoints(store.state)).filter(([joint]) => armJoints(store.state).includes(joint));
    wish(store, "joints", { ...Object.fromEntries(base), [name]: value_rad });
  };
  const slider = el("input", { type: "range", testid: `joint-${name}-slider`, label: `${name}, slider` });
  slider.addEventListener("input", () => take(fromUnit(Number(slider.value), store.state.settings.units)));
  const typed = numberField(`joint-${name}-number`, `${name}, number`, () => {
    const unit = store.state.settings.units;
    const [lower, upper] = range().map((limit) => toUnit(limit, unit)) as [number, number];
    return { name, lower, upper, unit: unitSign(unit), digits: unit === "deg" ? 1 : 3 };
  }, (value) => take(fromUnit(value, store.state.settings.units)));
  const measured = el("span", { class: "measured", testid: `joint-${name}-measured`, title: "where the joint is" });
  const limits = el("span", { class: "limits", testid: `joint-${name}-limits` });
  const head = el("div", { class: "row-head" }, el("b", { text: name }), measured, typed.input);
  const box = el("div", { class: "row" }, head, slider, limits, typed.problem);
  const show = (state: State): void => {
    const unit = state.settings.units;
    const [lower, upper] = range();
    const value_rad = shownJoints(state)[name] ?? Number.NaN;
    showSlider(slider, toUnit(value_rad, unit), toUnit(lower, unit), toUnit(upper, unit), angleStep(unit));
    typed.show(angleText(value_rad, unit));
    write(measured, `${angleText(present(state)[name] ?? Number.NaN, unit)}${unitSign(unit)}`);
    write(limits, `${angleText(lower, unit)} … ${angleText(upper, unit)}`);
  };
  return { name, box, show };
}

function showSlider(slider: HTMLInputElement, value: number, lower: number, upper: number, step: number): void {
  // Limits between two steps: a slider cannot go beyond them, and typing reaches them exactly.
  const wanted = { min: String(lower), max: String(upper), step: String(step) };
  for (const key of ["min", "max", "step"] as const) if (slider[key] !== wanted[key]) slider[key] = wanted[key];
  if (!Number.isFinite(value) || slider.matches(":active")) return;
  if (Math.abs(Number(slider.value) - value) > step / 2) slider.value = String(value);
}
