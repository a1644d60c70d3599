import "./drive.css";
import { armGripper, armJoints, DESCRIPTION, hasTip, jointKind } from "../logic/joints";
import { GRIPPER_RANGE_S } from "../link/servo-node";
import { isRotation, JogStep, scaled, tipAxes, type JogCommand, type TipAxis } from "../logic/jog";
import type { State } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { el, keyedList, labelled, loadPreference, section, setText, storePreference } from "./dom";
import { axisText, choice, watchHold, type JogControls } from "./drive-controls";
import { gamepadSection } from "./drive-gamepad";
import { keyboardSection } from "./drive-keyboard";
import { isTouch, padsSection } from "./drive-pads";
import { phoneSection } from "./phone";

/** Sizes of a step: of the tip and joints that slide, of turning, and of the gripper as a share of its range. */
const STEPS = [
  { length_mm: 1, angle_deg: 1, opening: 0.02 },
  { length_mm: 5, angle_deg: 5, opening: 0.1 },
  { length_mm: 20, angle_deg: 15, opening: 0.3 },
] as const;

/** Create the panel of driving by hand: settings, the servo node's status, and a section for each kind of input. */
export function driveSection(context: PanelContext): HTMLElement {
  const { controls, settings } = createControls(context);
  releaseWhenAway(context);
  const tip = jogGrid(context, controls, tipRows);
  const joints = jogGrid(context, controls, jointRows);
  joints.classList.add("wide-names");
  const sections = [section("drive-tip", t("drive.tip"), true, tip), section("drive-joints", t("drive.joints"), true, joints)];
  const buttons = permissionFieldset(context, "drive", ...sections);
  const pads = padsSection(context, controls);
  const others = [keyboardSection(context, controls), gamepadSection(context, controls), phoneSection(context)];
  // On a touch screen the pads come first, where the thumbs are.
  const rest = el("details", { class: "drive-rest", testid: "drive-rest" }, el("summary", { text: t("drive.more") }), settings, buttons, ...(isTouch() ? [] : [pads]), ...others);
  const inputs = el("div", {}, ...(isTouch() ? [pads] : []), rest);
  // A phone on its side: the pads stand left and right of the picture, and the rest is folded (drive.css).
  const lying = matchMedia("(max-height: 500px) and (pointer: coarse)");
  const fit = (): void => {
    rest.open = !lying.matches;
    if (lying.matches) pads.open = true;
  };
  fit();
  lying.addEventListener("change", fit);
  context.store.watch(DESCRIPTION, (state) => (inputs.hidden = !hasTip(state)));
  return el("div", { class: "drive", testid: "section-drive" }, statusLine(context), inputs);
}

/** A key or finger that is released elsewhere is not reported to this page. */
function releaseWhenAway({ jogSender }: PanelContext): void {
  const leave = (): void => jogSender.leave();
  for (const event of ["blur", "pagehide"]) window.addEventListener(event, leave);
  document.addEventListener("visibilitychange", leave);
}

function createControls(context: PanelContext): { controls: JogControls; settings: HTMLElement } {
  const { store, jogSender } = context;
  const steps = STEPS.map(({ length_mm, angle_deg }) => t("drive.mode.step", { length: length_mm, angle: angle_deg }));
  const mode = choice("drive-mode", t("drive.mode"), ["hold", "0", "1", "2"], [t("drive.mode.hold"), ...steps]);
  const frames = [t("drive.frame.base"), t("drive.frame.tool")];
  const frame = choice("drive-frame", t("drive.frame"), ["base", "tool"], frames, (value) => {
    jogSender.frame = value === "tool" ? "tool" : "base";
  });
  const attributes = { min: "0.1", max: "1", step: "0.1" };
  const speed = el("input", { type: "range", testid: "jog-speed", id: "jog-speed", attributes });
  speed.value = loadPreference("drive-speed", "0.5");
  const shown = el("output", { testid: "drive-speed-value" });
  const share = (): number => Number(speed.value);
  const show = ({ servo_node }: State): void => {
    const linear = Math.round(servo_node.linear_scale * share() * 1000);
    setText(shown, t("drive.speed.value", { linear, angular: degrees(servo_node.rotational_scale * share()) }));
  };
  speed.addEventListener("input", () => {
    storePreference("drive-speed", speed.value);
    show(store.state);
  });
  store.subscribe((state) => state.servo_node, (_, state) => show(state));
  const step = (input: string, command: JogCommand): void => {
    const { size, scale } = stepOf(store.state, command, STEPS[Number(mode.value) || 0] ?? STEPS[0]);
    jogSender.step(input, new JogStep(command, size, scale, share()));
  };
  const press = (input: string, command: JogCommand): void => {
    if (mode.value === "hold") jogSender.hold(input, scaled(command, share()));
    else step(input, command);
  };
  const release = (input: string): void => jogSender.release(input);
  mode.addEventListener("change", () => jogSender.releaseAll());
  const speed_line = el("label", { class: "line" }, t("drive.speed"), " ", speed, shown);
  const settings = el("div", { class: "drive-settings" }, labelled(t("drive.mode"), mode), labelled(t("drive.frame"), frame), speed_line);
  return { controls: { share, press, step, release }, settings };
}

/** Return the size of a step and the speed for a velocity of 1, in the unit that the command moves in. */
function stepOf(state: State, command: JogCommand, step: (typeof STEPS)[number]): { size: number; scale: number } {
  const { linear_scale, rotational_scale, joint_scale } = state.servo_node;
  const angle_rad = (step.angle_deg * Math.PI) / 180;
  const name = Object.keys(command.velocity)[0] ?? "";
  if (command.kind === "gripper") return { size: step.opening, scale: 1 / GRIPPER_RANGE_S };
  if (command.kind === "joints") {
    const slides = jointKind(state, name) === "prismatic";
    return { size: slides ? step.length_mm / 1000 : angle_rad, scale: joint_scale };
  }
  if (isRotation(name as TipAxis)) return { size: angle_rad, scale: rotational_scale };
  return { size: step.length_mm / 1000, scale: linear_scale };
}

function degrees(angle_rad: number): number {
  return Math.round((angle_rad * 180) / Math.PI);
}

/** Return what limits the arm in words; a message without a code is what of the command was given up. */
function statusText(code: number, message: string): string {
  if (code === 0) return message || t("drive.hint");
  const words = code >= -1 && code <= 6 ? t(`drive.status.${code}` as TextKey) : "";
  return `${words} ${message}`.trim();
}

/** Create the line that says what limits the arm. */
function statusLine({ store }: PanelContext): HTMLElement {
  const line = el("p", { class: "drive-status", testid: "drive-status", role: "status" });
  store.watch(["servo_node", ...DESCRIPTION], (state) => {
    const { code, message } = state.servo_node;
    setText(line, hasTip(state) ? statusText(code, message) : t("drive.one_arm"));
    line.dataset["code"] = String(code);
  });
  return line;
}

/** Row of buttons that move the arm: along an axis of the tip, by a joint, or by the gripper. */
interface JogRow {
  id: string;
  name: string;
  /** Command of the button that raises; the other one has the opposite. */
  command: JogCommand;
  texts: readonly [string, string];
}

const SIGNS = ["−", "+"] as const;

function tipRows(state: State): JogRow[] {
  return tipAxes(armJoints(state).length).map((axis) => {
    return { id: `jog-${axis}`, name: axisText(axis), command: { kind: "tip", velocity: { [axis]: 1 } }, texts: SIGNS };
  });
}

function jointRows(state: State): JogRow[] {
  const rows = armJoints(state).map((name): JogRow => {
    return { id: `jog-${name}`, name, command: { kind: "joints", velocity: { [name]: 1 } }, texts: SIGNS };
  });
  if (armGripper(state) === null) return rows;
  const texts = [t("drive.close"), t("drive.open")] as const;
  return [...rows, { id: "jog-gripper", name: t("drive.gripper"), command: { kind: "gripper", velocity: { opening: 1 } }, texts }];
}

/** Create a grid of rows; a button that is held keeps its element, and is let go where its row is gone. */
function jogGrid({ store, jogSender }: PanelContext, controls: JogControls, rows: (state: State) => JogRow[]): HTMLElement {
  const grid = el("div", { class: "jog-grid" });
  const show = keyedList<JogRow>(grid, ({ id, name }) => `${id} ${name}`, (row) => ({ element: jogRow(controls, row), show: () => undefined }));
  let known = "";
  store.watch(DESCRIPTION, (state) => {
    const shown = rows(state);
    const ids = shown.map(({ id }) => id).join();
    if (ids !== known) jogSender.releaseAll();
    known = ids;
    show(shown);
  });
  return grid;
}

function jogRow(controls: JogControls, { id, name, command, texts }: JogRow): HTMLElement {
  const buttons = ([-1, 1] as const).map((sign, index) => {
    const text = texts[index] ?? "";
    const label = text.length > 1 ? `${name}: ${text}` : t(sign < 0 ? "drive.minus" : "drive.plus", { name });
    return holdButton(controls, text, label, `${id}-${sign < 0 ? "minus" : "plus"}`, scaled(command, sign));
  });
  return el("div", { class: "jog-row" }, el("span", { text: name, title: name }), ...buttons);
}

/** Create a button that moves the arm while a finger, pen, mouse button or key holds it. */
function holdButton(controls: JogControls, text: string, label: string, testid: string, command: JogCommand): HTMLElement {
  const hold = el("button", { type: "button", class: "hold", text, label, testid });
  watchHold(hold, () => controls.press(testid, command), () => controls.release(testid));
  // A screen reader's press has no release, and no pointer either.
  hold.addEventListener("click", ({ detail, isTrusted }) => detail === 0 && isTrusted && controls.step(testid, command));
  return hold;
}
