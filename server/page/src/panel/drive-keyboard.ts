import { armGripper, armJoints, DESCRIPTION } from "../logic/joints";
import { tipAxes } from "../logic/jog";
import { GRIPPER_KEYS, jointKeys, keyCommand, printedKey, tipKeys, type KeyPair } from "../logic/jog-keys";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { el, section } from "./dom";
import { axisText, type JogControls } from "./drive-controls";

/** Create the section of the keyboard, which moves nothing until the user switches it on. */
export function keyboardSection(context: PanelContext, controls: JogControls): HTMLElement {
  const { store, jogSender } = context;
  const on = el("input", { type: "checkbox", testid: "jog" });
  const legend = el("div", { class: "key-legend", testid: "key-legend" });
  const show = (state: State): void => {
    const joints = armJoints(state);
    const tip = tipAxes(joints.length).map((axis) => keyLine(axisText(axis), tipKeys(axis)));
    const gripper = armGripper(state) ? [keyLine(t("drive.gripper"), GRIPPER_KEYS)] : [];
    legend.replaceChildren(...tip, ...gripper, ...joints.map((name, index) => keyLine(name, jointKeys(index))));
  };
  store.watch(DESCRIPTION, show);
  on.addEventListener("change", () => jogSender.releaseAll());
  listenForKeys(context, controls, () => on.checked, legend);
  const line = el("label", { class: "line" }, permissionFieldset(context, "drive", on), t("drive.keys.on"));
  return section("drive-keys", t("drive.keys"), false, line, legend, el("p", { class: "hint", text: t("drive.keys.hint") }));
}

function keyLine(name: string, keys: KeyPair | null): HTMLElement {
  const caps = (keys ?? []).map((code) => el("kbd", { text: printedKey(code), attributes: { "data-code": code } }));
  return el("div", {}, el("span", { text: name }), ...caps);
}

function listenForKeys({ store }: PanelContext, controls: JogControls, isOn: () => boolean, legend: HTMLElement): void {
  const mark = (code: string, held: boolean): void => {
    legend.querySelector(`[data-code="${code}"]`)?.toggleAttribute("data-held", held);
  };
  window.addEventListener("keydown", (event) => {
    if (!isOn() || isTyping(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
    const joints = armJoints(store.state);
    const command = keyCommand(event.code, tipAxes(joints.length), joints);
    if (command === null) return;
    event.preventDefault();
    if (event.repeat) return;
    mark(event.code, true);
    controls.press(`key ${event.code}`, command);
  });
  window.addEventListener("keyup", ({ code }) => {
    mark(code, false);
    controls.release(`key ${code}`);
  });
}

/** Return true for an element that uses keys itself. */
function isTyping(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return target.type !== "checkbox";
  return target.isContentEditable || target.matches("select, textarea, [role=tab]");
}
