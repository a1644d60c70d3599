import type { State } from "../state/state";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, setText } from "./dom";

/** Return the done part of a motion and its time left, as "34 % · 1.2 s left". */
export function progressText({ fraction, seconds_left }: Pick<State["goal"], "fraction" | "seconds_left">): string {
  const percent = `${Math.round(fraction * 100)} %`;
  return seconds_left === null ? percent : `${percent} · ${t("bar.left", { seconds: seconds_left.toFixed(1) })}`;
}

/** Create the progress of the motion, with the buttons along its path; it is hidden while the arm rests. */
export function motionBar(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const trigger = (service: string) => (): void => void commands.trigger(service);
  const progress = el("progress", { testid: "progress", label: t("bar.progress") });
  const left = el("output", { testid: "time-left" });
  const pause = button(t("bar.pause"), "pause", trigger("/arm/pause"), t("bar.pause.title"));
  const resume = button(t("bar.resume"), "resume", trigger("/arm/resume"), t("bar.resume.title"));
  const back = button(t("bar.back"), "step-back", trigger("/arm/step_back"), t("bar.back.title"));
  const buttons = el("div", { class: "buttons" }, permissionFieldset(context, "work", pause), permissionFieldset(context, "drive", resume, back));
  const box = el("div", { class: "motion", testid: "motion-bar", role: "group", label: t("bar.progress") });
  box.append(el("div", { class: "progress" }, progress, left), buttons);
  const show = ({ arm, goal, link }: State): void => {
    const executing = goal.state === "executing";
    const moving = link.connected && (executing || arm.mode === "moving");
    box.hidden = !moving;
    document.body.dataset["moving"] = String(moving);
    progress.hidden = left.hidden = !executing;
    progress.value = goal.fraction;
    setText(left, progressText(goal));
    pause.disabled = arm.course === "paused";
    resume.disabled = arm.course === "forward";
  };
  store.watch(["arm", "goal", "link"], show);
  return box;
}
