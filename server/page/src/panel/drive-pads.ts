import { armJoints, DESCRIPTION } from "../logic/joints";
import { scaled, tipAxes, isRotation, type TipAxis } from "../logic/jog";
import { LEFT_PAD, padCommand, rightPad, type PadAxes } from "../logic/jog-pads";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { el, section, setText } from "./dom";
import { axisText, choice, watchPointer, type JogControls } from "./drive-controls";

/** Create the section with two pads for thumbs, which move nothing while neither bar below them is held. */
export function padsSection(context: PanelContext, controls: JogControls): HTMLDetailsElement {
  const { store, jogSender } = context;
  const held = new Set<string>();
  let rotation: TipAxis | null = "pitch";
  const caption = el("span", {});
  const turning = choice("pad-rotation", t("drive.pads.rotation"), ["pitch", "roll", "yaw"], (["pitch", "roll", "yaw"] as const).map(axisText), (value) => {
    rotation = value as TipAxis;
  });
  const isHeld = (): boolean => held.size > 0;
  const left = pad(context, controls, "pad-left", t("drive.pads.left"), () => LEFT_PAD, isHeld);
  left.element.append(el("span", { text: "x ↕  y ↔" }));
  const right = pad(context, controls, "pad-right", t("drive.pads.left"), () => rightPad(rotation), isHeld);
  right.element.append(caption);
  const bars = ["dead-man-left", "dead-man-right"].map((testid) => {
    const bar = el("button", { type: "button", class: "pad-dead-man", testid, text: t("drive.pads.dead_man") });
    watchPointer(bar, () => {
      held.add(testid);
      for (const each of [left, right]) each.apply();
    }, () => {
      held.delete(testid);
      if (!isHeld()) for (const input of ["pad-left", "pad-right"]) jogSender.release(input);
    });
    return bar;
  });
  // After a stop the bars must be let go and held again.
  jogSender.onReleaseAll(() => held.clear());
  const show = (state: State): void => {
    const rotations = tipAxes(armJoints(state).length).filter(isRotation);
    for (const option of turning.options) option.disabled = option.hidden = !rotations.includes(option.value as TipAxis);
    if (rotation === null || !rotations.includes(rotation)) rotation = rotations[0] ?? null;
    if (rotation) turning.value = rotation;
    turning.disabled = rotation === null;
    const axis = rotation ? axisText(rotation) : "–";
    setText(caption, `z ↕  ${axis} ↔`);
    right.element.setAttribute("aria-label", t("drive.pads.right", { axis }));
  };
  turning.addEventListener("change", () => show(store.state));
  store.watch(DESCRIPTION, show);
  const sides = [left, right].map(({ element }, index) => el("div", { class: "pad-side" }, element, bars[index] ?? ""));
  const pads = permissionFieldset(context, "drive", el("div", { class: "pads" }, ...sides));
  const hint = el("p", { class: "hint", text: t("drive.pads.hint") });
  const line = el("label", { class: "line" }, `${t("drive.pads.rotation")} `, turning);
  return section("drive-pads", t("drive.pads"), isTouch(), pads, hint, line);
}

/** Return true on a device that is used by fingers first. */
export function isTouch(): boolean {
  return matchMedia("(pointer: coarse)").matches;
}

/** Create a pad; the thumb's way counts from where it has landed. */
function pad(
  { jogSender }: PanelContext,
  controls: JogControls,
  testid: string,
  label: string,
  axes: () => PadAxes,
  isHeld: () => boolean,
): { element: HTMLElement; apply: () => void } {
  const thumb = el("i", {});
  const element = el("div", { class: "pad", testid, role: "img", label }, thumb);
  let landed: { x: number; y: number } | null = null;
  let way = { right_px: 0, down_px: 0 };
  const apply = (): void => {
    thumb.style.transform = `translate(${way.right_px}px, ${way.down_px}px)`;
    if (landed === null || !isHeld()) return;
    const command = padCommand(axes(), way.right_px, way.down_px);
    if (Object.keys(command.velocity).length === 0) jogSender.release(testid);
    else jogSender.hold(testid, scaled(command, controls.share()));
  };
  watchPointer(
    element,
    ({ clientX: x, clientY: y }) => {
      landed = { x, y };
      const { left, top } = element.getBoundingClientRect();
      thumb.style.left = `${x - left}px`;
      thumb.style.top = `${y - top}px`;
    },
    () => {
      landed = null;
      way = { right_px: 0, down_px: 0 };
      apply();
      jogSender.release(testid);
    },
    ({ clientX, clientY }) => {
      if (landed === null) return;
      way = { right_px: clientX - landed.x, down_px: clientY - landed.y };
      apply();
    },
  );
  return { element, apply };
}
