import {
  armGripper,
  armJoints,
  currentPositions,
  DESCRIPTION,
  displayedPositions,
  hasTip,
  jointKind,
  jointLimits,
  shownPosition,
  takesOrientation,
} from "../logic/joints";
import { angleUnit, distanceText, fromUnit, lengthUnit, positionText, toUnit, unitOf, type NumberRange, type Unit } from "../logic/numbers";
import { robotInfo, planningGroup } from "../logic/robot-info";
import { AXES, ROTATIONS, quaternionOf, rollPitchYawOf, type RollPitchYaw } from "../logic/rotations";
import type { Orientation, Point, State } from "../state/state";
import { selectGoal, selectTarget } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, keyedList, numberField, option, section, setText, throttle, type ListItem, type NumberField } from "./dom";

/** Limit of typed coordinates [m], beyond the reach of any arm on a table or a mobile base. */
const MAX_COORDINATE_M = 5;

/** Time between two updates of numbers [ms]; faster ones cannot be read. */
const UPDATE_PERIOD_MS = 100;

/** Create the choice of the joint group that goals are for, which is hidden where there is one alone. */
export function groupChoice(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const choice = el("select", { testid: "group", label: t("group.label") });
  choice.addEventListener("change", () => commands.selectGroup(choice.value));
  const line = el("label", { class: "line" }, `${t("group.label")} `, choice);
  const box = permissionFieldset(context, "drive", line);
  const show = (state: State): void => {
    const names = robotInfo(state).groups.map(({ name }) => name);
    box.hidden = names.length < 2;
    if (names.join() !== [...choice.options].map(({ value }) => value).join()) {
      choice.replaceChildren(...names.map((name) => option(name, name)));
    }
    choice.value = planningGroup(state)?.name ?? "";
  };
  store.watch(["urdf", "srdf", "group"], show);
  return box;
}

/** Create the section with the target's coordinates and its reachability. */
export function targetSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const select = (position_m: Point, orientation: Orientation | null): void => {
    selectTarget(store, position_m, takesOrientation(store.state) ? orientation : null);
  };
  const length = (): Unit => lengthUnit(store.state.settings.units);
  const angle = (): Unit => angleUnit(store.state.settings.units);
  const places = AXES.map((axis, index) => {
    const range = (): NumberRange => unitRange(axis, MAX_COORDINATE_M, length());
    return numberField(`target-${axis}`, t("target.axis", { axis }), range, (value) => {
      const position_m = [...targetPosition(store.state)] as Point;
      position_m[index] = fromUnit(value, length());
      select(position_m, targetOrientation(store.state));
    });
  });
  const rotations = ROTATIONS.map(([name, limit_rad], index) => {
    const range = (): NumberRange => unitRange(name, limit_rad, angle());
    return numberField(`target-${name}`, t("target.axis", { axis: name }), range, (value) => {
      const angles = [...rollPitchYawOf(targetOrientation(store.state))] as RollPitchYaw;
      angles[index] = fromUnit(value, angle());
      select(targetPosition(store.state), quaternionOf(angles));
    });
  });
  const places_line = unitFields(AXES, places);
  const rotation_line = unitFields(ROTATIONS.map(([name]) => name), rotations);
  const reachability = el("p", { class: "hint", testid: "target-state", role: "status" });
  const problems = [...places, ...rotations].map(({ problem }) => problem);
  const box = section("target", t("target.title"), true, places_line.element, rotation_line.element, ...problems, reachability);
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const texts = targetPosition(state).map((value) => (Number.isFinite(value) ? positionText(value, length()) : ""));
    places.forEach((field, index) => field.show(texts[index] ?? ""));
    places_line.showUnit(length(), t("target.axis.unit"));
    rotation_line.showUnit(angle(), t("target.axis.unit"));
    rotation_line.element.hidden = !takesOrientation(state);
    box.hidden = !hasTip(state);
    const angles = rollPitchYawOf(targetOrientation(state));
    rotations.forEach((field, index) => field.show(positionText(angles[index] ?? 0, angle())));
    const selected = state.selection.kind === "target";
    setText(reachability, selected ? reachabilityText(state) : t("target.hint"));
    reachability.dataset["off"] = String(selected && state.target.reachable === false);
  });
  store.watch(["target", "selection", "tool_m", "tool_orientation", "settings", ...DESCRIPTION], show);
  return box;
}

/** Return the range of a field within a limit to either side [m or rad]. */
function unitRange(name: string, limit: number, unit: Unit): NumberRange {
  return { name, lower: -toUnit(limit, unit), upper: toUnit(limit, unit), unit: unit.suffix, digits: unit.digits };
}

/** Lay out fields with their axes before and their unit behind them, which changes with the settings. */
function unitFields(names: readonly string[], fields: readonly NumberField[]): { element: HTMLElement; showUnit: (unit: Unit, label: string) => void } {
  const units = fields.map(() => el("span", { class: "unit", attributes: { "aria-hidden": "true" } }));
  const labelled = fields.map(({ input }, index) => el("label", {}, el("b", { text: names[index] ?? "" }), input, units[index] ?? ""));
  const showUnit = (unit: Unit, label: string): void => {
    fields.forEach(({ input }, index) => {
      const spoken = label.replace("{axis}", names[index] ?? "").replace("{unit}", unit.suffix.trim());
      if (input.getAttribute("aria-label") !== spoken) input.setAttribute("aria-label", spoken);
      setText(units[index] ?? input, unit.suffix.trim());
    });
  };
  return { element: el("div", { class: "axes" }, ...labelled), showUnit };
}

function targetPosition({ selection, target: { position_m }, tool_m }: State): Point {
  return (selection.kind === "target" ? position_m : tool_m) ?? [0, 0, 0];
}

function targetOrientation({ selection, target: { orientation }, tool_orientation }: State): Orientation {
  return (selection.kind === "target" ? orientation : null) ?? tool_orientation ?? [0, 0, 0, 1];
}

function reachabilityText({ target: { reachable, distance_m }, settings }: State): string {
  if (reachable === null) return "…";
  if (reachable) return t("target.reachable");
  if (distance_m > 0) return t("target.out_of_reach", { distance: distanceText(distance_m, settings.units) });
  return t("target.touches");
}

/** Create the section with one row per joint: slider, number, measured position and limits. */
export function jointsSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("div", { class: "rows", testid: "joints" });
  const showRows = keyedList<string>(list, String, (name) => jointRow(context, name));
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => showRows(armJoints(state)));
  store.watch(["joints", "selection", "target", "settings", ...DESCRIPTION], show);
  const back = button(t("joints.back"), "forget-wish", () => selectGoal(store, "none", null));
  return section("joints", t("joints.title"), true, list, back);
}

function jointRow({ store }: PanelContext, name: string): ListItem<string> {
  const range = (): [number, number] => jointLimits(store.state)[name] ?? [-Math.PI, Math.PI];
  const unit = (): Unit => unitOf(jointKind(store.state, name), store.state.settings.units);
  const take = (value: number): void => {
    const names = armJoints(store.state);
    const displayed = Object.entries(displayedPositions(store.state)).filter(([joint]) => names.includes(joint));
    selectGoal(store, "joints", { ...Object.fromEntries(displayed), [name]: value });
  };
  const slider = el("input", { type: "range", testid: `joint-${name}-slider`, label: t("joints.slider", { name }) });
  slider.addEventListener("input", () => take(fromUnit(Number(slider.value), unit())));
  const typed = numberField(`joint-${name}-number`, t("joints.number", { name }), () => {
    const { suffix, digits } = unit();
    const [lower, upper] = range().map((limit) => toUnit(limit, unit())) as [number, number];
    return { name, lower, upper, unit: suffix, digits };
  }, (value) => take(fromUnit(value, unit())));
  const measured = el("span", { class: "measured", testid: `joint-${name}-measured`, title: t("joints.measured") });
  const limits = el("span", { class: "limits", testid: `joint-${name}-limits` });
  const head = el("div", { class: "row-head" }, el("b", { text: name }), measured, typed.input);
  const element = el("div", { class: "row" }, head, slider, limits, typed.problem);
  const show = (): void => {
    const { state } = store;
    const kind = jointKind(state, name);
    const shown = unitOf(kind, state.settings.units);
    const [lower, upper] = range();
    const position = (values: Record<string, number>): number => shownPosition(values[name] ?? Number.NaN, kind);
    showSlider(slider, position(displayedPositions(state)), lower, upper, shown);
    typed.show(positionText(position(displayedPositions(state)), shown));
    setText(measured, `${positionText(position(currentPositions(state)), shown)}${shown.suffix}`);
    setText(limits, kind === "continuous" ? t("joints.any") : `${positionText(lower, shown)} … ${positionText(upper, shown)}${shown.suffix}`);
  };
  return { element, show };
}

function showSlider(slider: HTMLInputElement, position: number, lower: number, upper: number, unit: Unit): void {
  // A slider rounds to its steps and so may miss its limits; typing reaches them exactly.
  const wanted = { min: String(toUnit(lower, unit)), max: String(toUnit(upper, unit)), step: String(unit.step) };
  for (const key of ["min", "max", "step"] as const) if (slider[key] !== wanted[key]) slider[key] = wanted[key];
  const value = toUnit(position, unit);
  if (!Number.isFinite(value) || slider.matches(":active")) return;
  if (Math.abs(Number(slider.value) - value) > unit.step / 2) slider.value = String(value);
}

/** Positions between the ends of a gripper that its slider distinguishes. */
const GRIPPER_STEPS = 1000;

/** Create the section of the gripper: a slider that moves it on release, and buttons for its ends. */
export function gripperSection(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const slider = el("input", { type: "range", testid: "gripper", label: t("gripper.label") });
  const measured = el("output", { testid: "gripper-measured" });
  const move = (position: number | undefined): void => void (position !== undefined && commands.moveGripper(position));
  slider.addEventListener("change", () => move(Number(slider.value)));
  const open = button(t("gripper.open"), "gripper-open", () => move(armGripper(store.state)?.open));
  const close = button(t("gripper.close"), "gripper-close", () => move(armGripper(store.state)?.closed));
  const line = el("div", { class: "line" }, close, slider, open, measured);
  const box = section("gripper", t("gripper.title"), true, permissionFieldset(context, "drive", line));
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const gripper = armGripper(state);
    box.hidden = gripper === null;
    if (gripper === null) return;
    const ends = [gripper.closed, gripper.open];
    const [lower, upper] = [Math.min(...ends), Math.max(...ends)];
    const wanted = { min: String(lower), max: String(upper), step: String((upper - lower) / GRIPPER_STEPS) };
    for (const key of ["min", "max", "step"] as const) if (slider[key] !== wanted[key]) slider[key] = wanted[key];
    // Open is on the right, also where its position is the smaller number.
    slider.dir = gripper.open < gripper.closed ? "rtl" : "ltr";
    const finger = gripper.joints[0] ?? "";
    const position = currentPositions(state)[finger] ?? Number.NaN;
    if (Number.isFinite(position) && !slider.matches(":active, :focus")) slider.value = String(position);
    const unit = unitOf(jointKind(state, finger), state.settings.units);
    setText(measured, `${positionText(position, unit)}${unit.suffix}`);
  });
  store.watch(["joints", "settings", ...DESCRIPTION], show);
  return box;
}
