import { isOpen } from "../logic/layout";
import { denialReason, type Operation } from "../logic/permissions";
import { duration_s } from "../logic/trajectory";
import type { State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, setText } from "./dom";
import { isAwaitingConfirmation } from "./status";

/** Step that the primary button takes. */
export interface PrimaryStep {
  action: "plan" | "go" | "pause" | "resume";
  label: string;
  /** Reason why the step cannot be taken now; empty without one. */
  reason: string;
}

const OPERATIONS: Record<PrimaryStep["action"], Operation> = { plan: "work", go: "drive", pause: "work", resume: "drive" };

/** Return the step towards a motion, or within one. */
export function primaryStep(state: State): PrimaryStep {
  const { arm, plan: { trajectory, executable }, selection, goal } = state;
  const step = (action: PrimaryStep["action"], label: string, reason = ""): PrimaryStep => {
    const offline = state.link.connected ? "" : t("bar.offline.disabled");
    return { action, label, reason: offline || denialReason(OPERATIONS[action], state) || reason };
  };
  if (isMoving(state)) return arm.course === "paused" ? step("resume", t("bar.resume")) : step("pause", t("bar.pause"));
  if (isAwaitingConfirmation(goal)) return step("plan", t("move.plan"), t("move.step.confirm"));
  if (trajectory && executable) return step("go", t("move.go", { seconds: duration_s(trajectory).toFixed(1) }));
  return step("plan", t("move.plan"), selection.kind === "none" ? t("move.step.choose") : "");
}

function isMoving({ link, goal, arm }: State): boolean {
  return link.connected && (goal.state === "executing" || arm.mode === "moving");
}

/** Return the next step to a motion in words. */
export function nextStep({ link, goal, selection }: Pick<State, "link" | "goal" | "selection">): string {
  if (!link.connected) return t("bar.offline.disabled");
  if (isAwaitingConfirmation(goal)) return t("move.step.confirm");
  return t(selection.kind === "none" ? "move.step.choose" : "move.step.plan");
}

/** Return the done part of a motion and its time left, as "34 % · 1.2 s left". */
function progressText({ fraction, seconds_left }: State["goal"]): string {
  const percent = `${Math.round(fraction * 100)} %`;
  return seconds_left === null ? percent : `${percent} · ${t("bar.left", { seconds: seconds_left.toFixed(1) })}`;
}

/** Create the bar below the picture: one button that plans, starts and pauses, and the time on the motion. */
export function transportBar(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const primary = primaryButton(context);
  const back = button("⏮", "step-back", () => void commands.trigger("/arm/step_back"), t("bar.back.title"));
  back.setAttribute("aria-label", t("bar.back"));
  const play = button("", "replay", () => store.patch("plan", { replaying: !store.state.plan.replaying }));
  const slider = el("input", { type: "range", testid: "scrubber", label: t("scrubber.time"), attributes: { min: "0", max: "0", step: "0.01" } });
  slider.addEventListener("input", () => store.patch("plan", { replaying: false, scrub_s: Number(slider.value) }));
  const progress = el("progress", { testid: "progress", label: t("bar.progress") });
  const text = el("output", { testid: "time-left" });
  const hint = el("p", { class: "hint", id: "next-step", testid: "next-step", role: "status" });
  primary.setAttribute("aria-describedby", hint.id);
  const box = el("div", { class: "transport", testid: "transport", role: "group", label: t("move.title") });
  box.append(primary, permissionFieldset(context, "drive", back), play, slider, progress, text, hint);
  const replay = new PlanReplay(store);
  store.watch(["arm", "goal", "link", "plan", "selection", "layout"], (state) => {
    const { plan: { trajectory, scrub_s, replaying }, goal, layout } = state;
    const moving = isMoving(state);
    replay.update();
    box.hidden = !moving && trajectory === null && !isOpen(layout, "move");
    back.hidden = !moving;
    progress.hidden = !moving || goal.state !== "executing";
    play.hidden = slider.hidden = moving || trajectory === null;
    text.hidden = progress.hidden && slider.hidden;
    hint.hidden = moving || trajectory !== null;
    progress.value = goal.fraction;
    setText(hint, nextStep(state));
    setText(play, replaying ? "❚❚" : "▶");
    play.title = t(replaying ? "scrubber.halt" : "scrubber.replay");
    play.setAttribute("aria-label", play.title);
    const end_s = trajectory ? duration_s(trajectory) : 0;
    slider.max = String(end_s);
    slider.value = String(scrub_s ?? end_s);
    const times = { now: (scrub_s ?? end_s).toFixed(1), end: end_s.toFixed(1) };
    setText(text, moving ? progressText(goal) : t("scrubber.of", times));
  });
  return box;
}

/** Create the button that takes the next step: Plan, then Go, then Pause and Resume. */
function primaryButton({ store, moveGroup, commands }: PanelContext): HTMLButtonElement {
  const actions: Record<PrimaryStep["action"], () => void> = {
    plan: () => void moveGroup.plan(),
    go: () => void moveGroup.execute(),
    pause: () => void commands.trigger("/arm/pause"),
    resume: () => void commands.trigger("/arm/resume"),
  };
  const primary = el("button", { type: "button", class: "primary", testid: "primary" });
  primary.addEventListener("click", ({ detail }) => {
    // The second click of a double click, and a key that repeats, must not take the step after the one that was meant.
    if (detail <= 1) actions[primaryStep(store.state).action]();
  });
  primary.addEventListener("keydown", (event) => event.repeat && event.preventDefault());
  store.watch(["arm", "goal", "link", "plan", "selection", "identity", "control"], (state) => {
    const { action, label, reason } = primaryStep(state);
    setText(primary, label);
    primary.dataset["action"] = action;
    primary.disabled = reason !== "";
    primary.title = reason || t(`move.${action}.title`);
  });
  return primary;
}

/** Replay of the plan by the ghost, in real time, while the state of the plan says so. */
class PlanReplay {
  private began_ms: number | null = null;

  constructor(private readonly store: PageStore) {}

  /** Begin or end as the plan says. */
  update(): void {
    const { replaying } = this.store.state.plan;
    if (!replaying) this.began_ms = null;
    else if (this.began_ms === null) {
      this.began_ms = performance.now();
      requestAnimationFrame(() => this.step());
    }
  }

  private step(): void {
    const { trajectory } = this.store.state.plan;
    if (this.began_ms === null || !trajectory) return;
    const now_s = (performance.now() - this.began_ms) / 1000;
    const end_s = duration_s(trajectory);
    this.store.patch("plan", { scrub_s: Math.min(now_s, end_s), replaying: now_s < end_s });
    if (now_s < end_s) requestAnimationFrame(() => this.step());
  }
}
