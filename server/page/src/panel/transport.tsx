import type { JSX } from "preact";
import { useEffect } from "preact/hooks";
import { isOneArm } from "../logic/joints";
import { isOpen } from "../logic/layout";
import { denialReason, type Operation } from "../logic/permissions";
import { duration_s } from "../logic/trajectory";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import { isAwaitingConfirmation } from "./status";
import { Gate, SignButton, usePage } from "./ui";

export interface PrimaryStep {
  action: "plan" | "go" | "pause" | "resume";
  label: string;
  /** Reason why the step cannot be taken now; empty without one. */
  reason: string;
}

const OPERATIONS: Record<PrimaryStep["action"], Operation> = { plan: "work", go: "drive", pause: "work", resume: "drive" };

export function primaryStep(state: State): PrimaryStep {
  const { arm, plan: { trajectory, executable }, selection, goal } = state;
  const step = (action: PrimaryStep["action"], label: string, reason = ""): PrimaryStep => {
    const offline = state.link.connected ? "" : t("bar.offline.disabled");
    return { action, label, reason: offline || denialReason(OPERATIONS[action], state) || reason };
  };
  if (isMoving(state)) return arm.course === "paused" ? step("resume", t("bar.resume")) : step("pause", t("bar.pause"));
  if (isAwaitingConfirmation(goal)) return step("plan", t("move.plan"), t("move.step.confirm"));
  if (trajectory && executable) return step("go", t("move.go", { seconds: duration_s(trajectory).toFixed(1) }));
  return step("plan", t("move.plan"), selection.kind === "none" ? t(isOneArm(state) ? "move.step.choose" : "answer.no_goal") : "");
}

function isMoving({ link, goal, arm }: State): boolean {
  return link.connected && (goal.state === "executing" || arm.mode === "moving");
}

export function nextStep(state: State): string {
  return primaryStep(state).reason || t("move.step.plan");
}

function progressText({ fraction, seconds_left }: State["goal"]): string {
  const percent = `${Math.round(fraction * 100)} %`;
  return seconds_left === null ? percent : `${percent} · ${t("bar.left", { seconds: seconds_left.toFixed(1) })}`;
}

export function TransportBar(): JSX.Element {
  const { store, commands } = usePage();
  const { state } = store;
  const { plan: { trajectory, scrub_s, replaying }, goal, layout } = state;
  useReplay();
  const moving = isMoving(state);
  const has_progress = moving && goal.state === "executing";
  const has_plan = !moving && trajectory !== null;
  const end_s = trajectory ? duration_s(trajectory) : 0;
  const shown_s = scrub_s ?? end_s;
  const times = { now: shown_s.toFixed(1), end: end_s.toFixed(1) };
  return (
    <div class="transport" data-testid="transport" role="group" aria-label={t("move.title")} hidden={!moving && trajectory === null && !isOpen(layout, "move")}>
      <PrimaryButton />
      <Gate to="drive"><SignButton sign="◀" testid="step-back" title={t("bar.back.title")} label={t("bar.back")} hidden={!moving} press={() => void commands.trigger("/arm/step_back")} /></Gate>
      <SignButton sign={replaying ? "❚❚" : "▶"} testid="replay" label={t(replaying ? "scrubber.halt" : "scrubber.replay")} hidden={!has_plan} press={() => store.patch("plan", { replaying: !store.state.plan.replaying })} />
      <input
        type="range" data-testid="scrubber" aria-label={t("scrubber.time")} min="0" max={end_s} step="0.01" value={shown_s} hidden={!has_plan}
        onInput={({ currentTarget }) => store.patch("plan", { replaying: false, scrub_s: Number(currentTarget.value) })}
      />
      <progress data-testid="progress" aria-label={t("bar.progress")} value={goal.fraction} hidden={!has_progress} />
      <output data-testid="time-left" hidden={!has_progress && !has_plan}>{moving ? progressText(goal) : t("scrubber.of", times)}</output>
      <p class="hint" id="next-step" data-testid="next-step" role="status" hidden={moving || trajectory !== null}>{nextStep(state)}</p>
    </div>
  );
}

function PrimaryButton(): JSX.Element {
  const { store, moveGroup, commands } = usePage();
  const actions: Record<PrimaryStep["action"], () => void> = {
    plan: () => void moveGroup.plan(),
    go: () => void moveGroup.execute(),
    pause: () => void commands.trigger("/arm/pause"),
    resume: () => void commands.trigger("/arm/resume"),
  };
  const { action, label, reason } = primaryStep(store.state);
  // The second click of a double click, and a key that repeats, must not take the step after the one that was meant.
  const press = ({ detail }: MouseEvent): void => {
    if (detail <= 1) actions[primaryStep(store.state).action]();
  };
  return (
    <button
      type="button" class="primary" data-testid="primary" aria-describedby="next-step" data-action={action} disabled={reason !== ""} title={reason || t(`move.${action}.title`)}
      onClick={press} onKeyDown={(event) => event.repeat && event.preventDefault()}
    >{label}</button>
  );
}

/** Replay the plan by the ghost, in real time, while the state of the plan says so. */
function useReplay(): void {
  const { store } = usePage();
  const { replaying, trajectory } = store.state.plan;
  useEffect(() => {
    if (!replaying || !trajectory) return;
    const began_ms = performance.now();
    const end_s = duration_s(trajectory);
    const step = (): void => {
      const now_s = (performance.now() - began_ms) / 1000;
      if (now_s < end_s) frame = requestAnimationFrame(step);
      store.patch("plan", { scrub_s: Math.min(now_s, end_s), replaying: now_s < end_s });
    };
    let frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [replaying, trajectory]);
}
