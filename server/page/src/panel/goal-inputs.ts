import {
  armGripper,
  armJoints,
  currentPositions,
  displayedPositions,
  jointKind,
  jointLimits,
  shownPosition,
  takesOrientation,
} from "../logic/joints";
import { distanceText, fromUnit, positionText, toUnit, unitOf, type Unit } from "../logic/numbers";
import { robotInfo, planningGroup } from "../logic/robot-info";
import { quaternionOf, rollPitchYawOf, type RollPitchYaw } from "../logic/rotations";
import type { Orientation, Point, State, TargetState } from "../state/state";
import { selectGoal, selectTarget } from "../state/store";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, loadPreference, numberField, section, setText, storePreference, throttle } from "./dom";

/** Limit of typed coordinates [m], beyond the reach of any arm on a table or a mobile base. */
const MAX_COORDINATE_M = 5;

/** Time between two updates of numbers [ms]; faster ones cannot be read. */
const UPDATE_PERIOD_MS = 100;

const AXES = ["x", "y", "z"] as const;

/** Rotations about the fixed axes x, y and z, with their limits [degrees]. */
const ROTATIONS = [["roll", 180], ["pitch", 90], ["yaw", 180]] as const;

const DEGREES = unitOf("revolute", "deg");

/** Parts of the state that tell which joints there are. */
const DESCRIPTION = ["limits", "named", "urdf", "srdf", "group"] as const;

/** Create the choice of the joint group that goals are for, which is hidden where there is one alone. */
export function groupChoice(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const choice = el("select", { testid: "group", label: "joint group" });
  choice.addEventListener("change", () => commands.selectGroup(choice.value));
  const line = el("label", { class: "line" }, "Joint group ", choice);
  const box = permissionFieldset(context, "drive", line);
  const show = (state: State): void => {
    const names = robotInfo(state).groups.map(({ name }) => name);
    box.hidden = names.length < 2;
    if (names.join() !== [...choice.options].map(({ value }) => value).join()) {
      choice.replaceChildren(...names.map((name) => option(name, name)));
    }
    choice.value = planningGroup(state)?.name ?? "";
  };
  for (const part of ["urdf", "srdf", "group"] as const) store.subscribe((state) => state[part], (_, state) => show(state));
  return box;
}

/** Create the section with the target's coordinates and its reachability. */
export function targetSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const select = (position_m: Point, orientation: Orientation | null): void => {
    selectTarget(store, position_m, takesOrientation(store.state) ? orientation : null);
  };
  const places = AXES.map((axis, index) => {
    const range = { name: axis, lower: -MAX_COORDINATE_M, upper: MAX_COORDINATE_M, unit: " m", digits: 4 };
    return numberField(`target-${axis}`, `target ${axis} in metres`, () => range, (value) => {
      const position_m = [...targetPosition(store.state)] as Point;
      position_m[index] = value;
      select(position_m, targetOrientation(store.state));
    });
  });
  const rotations = ROTATIONS.map(([name, limit], index) => {
    const range = { name, lower: -limit, upper: limit, unit: DEGREES.suffix, digits: DEGREES.digits };
    return numberField(`target-${name}`, `target ${name} in degrees`, () => range, (value) => {
      const angles = [...rollPitchYawOf(targetOrientation(store.state))] as RollPitchYaw;
      angles[index] = fromUnit(value, DEGREES);
      select(targetPosition(store.state), quaternionOf(angles));
    });
  });
  const labelled = (names: readonly string[], fields: typeof places): HTMLElement => {
    return el("div", { class: "axes" }, ...fields.map(({ input }, index) => el("label", {}, `${names[index]} `, input)));
  };
  const rotation_line = labelled(ROTATIONS.map(([name]) => name), rotations);
  const reachability = el("p", { class: "hint", testid: "target-state", role: "status" });
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const texts = targetPosition(state).map((value) => (Number.isFinite(value) ? value.toFixed(4) : ""));
    places.forEach((field, index) => field.show(texts[index] ?? ""));
    rotation_line.hidden = !takesOrientation(state);
    const angles = rollPitchYawOf(targetOrientation(state));
    rotations.forEach((field, index) => field.show(positionText(angles[index] ?? 0, DEGREES)));
    const selected = state.selection.kind === "target";
    setText(reachability, selected ? reachabilityText(state.target) : "Drag the arrows at the tool, or type a point.");
    reachability.dataset["off"] = String(selected && state.target.reachable === false);
  });
  for (const part of ["target", "selection", "tool_m", "tool_orientation", ...DESCRIPTION] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const problems = [...places, ...rotations].map(({ problem }) => problem);
  const place_line = labelled(AXES, places);
  return section("target", "Target of the tool (m)", true, place_line, rotation_line, ...problems, reachability);
}

function targetPosition({ selection, target: { position_m }, tool_m }: State): Point {
  return (selection.kind === "target" ? position_m : tool_m) ?? [0, 0, 0];
}

function targetOrientation({ selection, target: { orientation }, tool_orientation }: State): Orientation {
  return (selection.kind === "target" ? orientation : null) ?? tool_orientation ?? [0, 0, 0, 1];
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
  for (const part of ["joints", "selection", "target", "settings", ...DESCRIPTION] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const back = button("Back to where the arm is", "forget-wish", () => selectGoal(store, "none", null));
  return section("joints", "Joints", true, unitSwitch(context), list, back);
}

function unitSwitch({ store }: PanelContext): HTMLElement {
  const units = el("select", { testid: "units", id: "units" }, option("deg", "degrees and millimetres"), option("rad", "radians and metres"));
  units.addEventListener("change", () => {
    const chosen = units.value === "rad" ? "rad" : "deg";
    storePreference("units", chosen);
    store.patch("settings", { units: chosen });
  });
  store.patch("settings", { units: loadPreference("units", "deg") === "rad" ? "rad" : "deg" });
  units.value = store.state.settings.units;
  return el("label", { class: "line" }, "Positions in ", units);
}

function option(value: string, text: string): HTMLOptionElement {
  return el("option", { text, attributes: { value } });
}

function jointRow({ store }: PanelContext, name: string): JointRow {
  const range = (): [number, number] => jointLimits(store.state)[name] ?? [-Math.PI, Math.PI];
  const unit = (): Unit => unitOf(jointKind(store.state, name), store.state.settings.units);
  const take = (value: number): void => {
    const names = armJoints(store.state);
    const displayed = Object.entries(displayedPositions(store.state)).filter(([joint]) => names.includes(joint));
    selectGoal(store, "joints", { ...Object.fromEntries(displayed), [name]: value });
  };
  const slider = el("input", { type: "range", testid: `joint-${name}-slider`, label: `${name}, slider` });
  slider.addEventListener("input", () => take(fromUnit(Number(slider.value), unit())));
  const typed = numberField(`joint-${name}-number`, `${name}, number`, () => {
    const { suffix, digits } = unit();
    const [lower, upper] = range().map((limit) => toUnit(limit, unit())) as [number, number];
    return { name, lower, upper, unit: suffix, digits };
  }, (value) => take(fromUnit(value, unit())));
  const measured = el("span", { class: "measured", testid: `joint-${name}-measured`, title: "where the joint is" });
  const limits = el("span", { class: "limits", testid: `joint-${name}-limits` });
  const head = el("div", { class: "row-head" }, el("b", { text: name }), measured, typed.input);
  const box = el("div", { class: "row" }, head, slider, limits, typed.problem);
  const show = (state: State): void => {
    const kind = jointKind(state, name);
    const shown = unitOf(kind, state.settings.units);
    const [lower, upper] = range();
    const position = (values: Record<string, number>): number => shownPosition(values[name] ?? Number.NaN, kind);
    showSlider(slider, position(displayedPositions(state)), lower, upper, shown);
    typed.show(positionText(position(displayedPositions(state)), shown));
    setText(measured, `${positionText(position(currentPositions(state)), shown)}${shown.suffix}`);
    setText(limits, kind === "continuous" ? "any angle" : `${positionText(lower, shown)} … ${positionText(upper, shown)}`);
  };
  return { name, box, show };
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
  const slider = el("input", { type: "range", testid: "gripper", label: "gripper, closed to open" });
  const measured = el("output", { testid: "gripper-measured" });
  const move = (position: number | undefined): void => void (position !== undefined && commands.moveGripper(position));
  slider.addEventListener("change", () => move(Number(slider.value)));
  const open = button("Open", "gripper-open", () => move(armGripper(store.state)?.open));
  const close = button("Close", "gripper-close", () => move(armGripper(store.state)?.closed));
  const line = el("div", { class: "line" }, close, slider, open, measured);
  const box = section("gripper", "Gripper", true, permissionFieldset(context, "drive", line));
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
  for (const part of ["joints", "settings", "actions", ...DESCRIPTION] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  return box;
}
