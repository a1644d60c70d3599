import { armJoints, currentPositions, displayedPositions, gripperJoint, jointLimits } from "../logic/joints";
import { angleStep, angleText, distanceText, fromUnit, toUnit, unitSuffix } from "../logic/numbers";
import type { Point, State, TargetState } from "../state/state";
import { selectGoal, selectTarget } from "../state/store";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, loadPreference, numberField, section, setText, storePreference, throttle } from "./dom";

/** Limit of typed coordinates [m], beyond the reach of any small arm. */
const MAX_COORDINATE_M = 2;

/** Time between two updates of numbers [ms]; faster ones cannot be read. */
const UPDATE_PERIOD_MS = 100;

const AXES = ["x", "y", "z"] as const;

/** Create the section with the target's coordinates and its reachability. */
export function targetSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const fields = AXES.map((axis, index) => {
    const range = { name: axis, lower: -MAX_COORDINATE_M, upper: MAX_COORDINATE_M, unit: " m", digits: 4 };
    return numberField(`target-${axis}`, `target ${axis} in metres`, () => range, (value) => {
      const position_m = [...targetPosition(store.state)] as Point;
      position_m[index] = value;
      selectTarget(store, position_m);
    });
  });
  const reachability = el("p", { class: "hint", testid: "target-state", role: "status" });
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const texts = targetPosition(state).map((value) => (Number.isFinite(value) ? value.toFixed(4) : ""));
    fields.forEach((field, index) => field.show(texts[index] ?? ""));
    const selected = state.selection.kind === "target";
    setText(reachability, selected ? reachabilityText(state.target) : "Drag the arrows at the tool, or type a point.");
    reachability.dataset["off"] = String(selected && state.target.reachable === false);
  });
  for (const part of ["target", "selection", "tool_m"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const boxes = AXES.map((axis, index) => el("label", {}, `${axis} `, fields[index]?.input ?? ""));
  const problems = fields.map(({ problem }) => problem);
  const line = el("div", { class: "axes" }, ...boxes);
  return section("target", "Target of the tool (m)", true, line, ...problems, reachability);
}

function targetPosition({ selection, target: { position_m }, tool_m }: State): Point {
  return (selection.kind === "target" ? position_m : tool_m) ?? [0, 0, 0];
}

function reachabilityText({ reachable, distance_m }: TargetState): string {
  if (reachable === null) return "…";
  if (reachable) return "The arm can be there.";
  if (distance_m > 0) return `Out of reach: the nearest the tool comes is ${distanceText(distance_m)} away.`;
  return "The arm would touch something there.";
}

interface JointRow {
  name: string;
  box: HTMLElement;
  show: (state: State) => void;
}

/** Create the section with one row per joint: slider, number, measured position and limits. */
export function jointsSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("div", { class: "rows", testid: "joints" });
  let rows: JointRow[] = [];
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const names = armJoints(state);
    if (names.join() !== rows.map(({ name }) => name).join()) {
      rows = names.map((name) => jointRow(context, name));
      list.replaceChildren(...rows.map(({ box }) => box));
    }
    for (const row of rows) row.show(state);
  });
  for (const part of ["joints", "limits", "named", "selection", "target", "settings", "urdf"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const back = button("Back to where the arm is", "forget-wish", () => selectGoal(store, "none", null));
  return section("joints", "Joints", true, unitSwitch(context), list, back);
}

function unitSwitch({ store }: PanelContext): HTMLElement {
  const units = el("select", { testid: "units", id: "units" }, option("deg", "degrees"), option("rad", "radians"));
  units.addEventListener("change", () => {
    const chosen = units.value === "rad" ? "rad" : "deg";
    storePreference("units", chosen);
    store.patch("settings", { units: chosen });
  });
  store.patch("settings", { units: loadPreference("units", "deg") === "rad" ? "rad" : "deg" });
  units.value = store.state.settings.units;
  return el("label", { class: "line" }, "Angles in ", units);
}

function option(value: string, text: string): HTMLOptionElement {
  return el("option", { text, attributes: { value } });
}

function jointRow({ store }: PanelContext, name: string): JointRow {
  const range = (): [number, number] => jointLimits(store.state)[name] ?? [-Math.PI, Math.PI];
  const take = (value_rad: number): void => {
    const names = armJoints(store.state);
    const displayed = Object.entries(displayedPositions(store.state)).filter(([joint]) => names.includes(joint));
    selectGoal(store, "joints", { ...Object.fromEntries(displayed), [name]: value_rad });
  };
  const slider = el("input", { type: "range", testid: `joint-${name}-slider`, label: `${name}, slider` });
  slider.addEventListener("input", () => take(fromUnit(Number(slider.value), store.state.settings.units)));
  const typed = numberField(`joint-${name}-number`, `${name}, number`, () => {
    const unit = store.state.settings.units;
    const [lower, upper] = range().map((limit) => toUnit(limit, unit)) as [number, number];
    return { name, lower, upper, unit: unitSuffix(unit), digits: unit === "deg" ? 1 : 3 };
  }, (value) => take(fromUnit(value, store.state.settings.units)));
  const measured = el("span", { class: "measured", testid: `joint-${name}-measured`, title: "where the joint is" });
  const limits = el("span", { class: "limits", testid: `joint-${name}-limits` });
  const head = el("div", { class: "row-head" }, el("b", { text: name }), measured, typed.input);
  const box = el("div", { class: "row" }, head, slider, limits, typed.problem);
  const show = (state: State): void => {
    const unit = state.settings.units;
    const [lower, upper] = range();
    const value_rad = displayedPositions(state)[name] ?? Number.NaN;
    showSlider(slider, toUnit(value_rad, unit), toUnit(lower, unit), toUnit(upper, unit), angleStep(unit));
    typed.show(angleText(value_rad, unit));
    setText(measured, `${angleText(currentPositions(state)[name] ?? Number.NaN, unit)}${unitSuffix(unit)}`);
    setText(limits, `${angleText(lower, unit)} … ${angleText(upper, unit)}`);
  };
  return { name, box, show };
}

function showSlider(slider: HTMLInputElement, value: number, lower: number, upper: number, step: number): void {
  // A slider rounds to its steps and so may miss its limits; typing reaches them exactly.
  const wanted = { min: String(lower), max: String(upper), step: String(step) };
  for (const key of ["min", "max", "step"] as const) if (slider[key] !== wanted[key]) slider[key] = wanted[key];
  if (!Number.isFinite(value) || slider.matches(":active")) return;
  if (Math.abs(Number(slider.value) - value) > step / 2) slider.value = String(value);
}

/** Create the section of the gripper: a slider that moves it on release, and buttons for its ends. */
export function gripperSection(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const ends = (): [number, number] => jointLimits(store.state)[gripperJoint(store.state) ?? ""] ?? [0, 1];
  const attributes = { min: "0", max: "1", step: "0.001" };
  const slider = el("input", { type: "range", testid: "gripper", label: "gripper, closed to open", attributes });
  const measured = el("output", { testid: "gripper-measured" });
  slider.addEventListener("change", () => void commands.moveGripper(Number(slider.value)));
  const open = button("Open", "gripper-open", () => void commands.moveGripper(ends()[1]));
  const close = button("Close", "gripper-close", () => void commands.moveGripper(ends()[0]));
  const line = el("div", { class: "line" }, close, slider, open, measured);
  const box = section("gripper", "Gripper", true, permissionFieldset(context, "drive", line));
  const show = throttle<State>(100, (state) => {
    const joint = gripperJoint(state);
    box.hidden = joint === null;
    if (joint === null) return;
    const [lower, upper] = ends();
    slider.min = String(lower);
    slider.max = String(upper);
    const value_rad = currentPositions(state)[joint] ?? Number.NaN;
    if (Number.isFinite(value_rad) && !slider.matches(":active, :focus")) slider.value = String(value_rad);
    setText(measured, `${angleText(value_rad, state.settings.units)}${unitSuffix(state.settings.units)}`);
  });
  for (const part of ["joints", "limits", "named", "settings"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  return box;
}
