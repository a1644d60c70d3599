import type { JSX } from "preact";
import { useLayoutEffect } from "preact/hooks";
import { inUnits } from "../logic/numbers";
import { errorCodeName, PREEMPTED, SUCCESS } from "../link/messages";
import type { GoalState, Notice, State } from "../state/state";
import { capitalized, t, type TextKey } from "../texts/texts";
import { askedText } from "./goals";
import { Button, Gate, SignButton, usePage } from "./ui";

export interface Pill {
  label: string;
  kind: "idle" | "busy" | "stopped" | "fault" | "off";
}

type StatusInput = Pick<State, "link" | "arm" | "goal" | "pending_request" | "settings">;

export function statePill(state: StatusInput): Pill {
  const [name, kind] = stateName(state);
  return { label: t(`state.${name}` as TextKey), kind };
}

function stateName({ link, arm, goal, pending_request }: StatusInput): [string, Pill["kind"]] {
  if (!link.connected) return [arm.mode === "" && !link.refused ? "connecting" : "offline", "off"];
  if (isBeingChecked(arm)) return ["checking", "off"];
  if (arm.mode === "fault") return ["fault", "fault"];
  if (arm.mode === "disconnected") return ["no_arm", "fault"];
  if (goal.state === "executing" || arm.mode === "moving") return [{ paused: "paused", back: "back" }[arm.course] ?? "executing", "busy"];
  if (isAwaitingConfirmation(goal)) return ["waiting", "busy"];
  if (goal.state === "planning" || pending_request === "plan") return ["planning", "busy"];
  if (arm.mode === "relaxing" || arm.mode === "relaxed") return [arm.mode, "off"];
  if (goal.state === "done" && goal.code === PREEMPTED) return ["stopped", "stopped"];
  return ["idle", "idle"];
}

/** Return true for a goal that is planned and waits for a person; a plan of this page has no id. */
export function isAwaitingConfirmation({ id, state }: GoalState): boolean {
  return state === "planned" && id !== "";
}

/** Return true before the server has told the arm's mode, and while it starts and checks the arm, which is no fault. */
function isBeingChecked({ mode, task }: State["arm"]): boolean {
  return mode === "" || mode === "connected" || (mode === "disconnected" && task === "starting");
}

/** Return the sentence beside the pill: what is the matter and what to do, else the state or result of the goal. */
export function statusText(state: StatusInput): string {
  return inUnits(serverText(state), state.settings.units);
}

function serverText({ link, arm, goal }: StatusInput): string {
  if (link.refused) return t("status.token");
  if (!link.connected) return t(arm.mode === "" ? "status.connecting" : "status.offline");
  if (isBeingChecked(arm)) return `${t("status.checking")} ${sentence(arm.reason)}`.trim();
  if (arm.mode === "fault") return `${sentence(arm.fault_message)} ${sentence(arm.fault_remedy)}`.trim();
  if (arm.mode === "disconnected") return `${t("status.no_arm")} ${sentence(arm.reason)}`.trim();
  if (goal.state === "done" && goal.code !== null && goal.code !== SUCCESS) return sentence(goal.message);
  if (arm.mode === "relaxing" || arm.mode === "relaxed") return t(`status.${arm.mode}`);
  if (goal.message) return sentence(goal.message);
  return arm.mode === "holding" ? t("status.holding") : sentence(arm.message);
}

/** Return the code behind the sentence, for those who look it up; empty without one. */
export function statusCode({ link, arm, goal }: StatusInput): string {
  if (!link.connected) return "";
  if (arm.mode === "fault") return arm.fault;
  const failed = goal.state === "done" && goal.code !== null && goal.code !== SUCCESS;
  return failed ? `${errorCodeName(goal.code ?? 0)} (${goal.code})` : "";
}

function sentence(text: string): string {
  return text === "" || /[.!?…]$/.test(text) ? capitalized(text) : `${capitalized(text)}.`;
}

export function StatusBar(): JSX.Element {
  const { store, commands } = usePage();
  const { state } = store;
  const { arm, goal, link: { connected } } = state;
  const { label, kind } = statePill(state);
  useLayoutEffect(() => void (document.title = t("bar.title", { state: label })), [label]);
  const [text, code] = [statusText(state), statusCode(state)];
  const { suggestion } = goal;
  const is_waiting = isAwaitingConfirmation(goal) && connected;
  return (
    <>
      <span class="pill" id="state-pill" data-testid="state-pill" aria-label={t("bar.state")} role="status" data-kind={kind} data-code={goal.code === null ? "" : errorCodeName(goal.code)}>{label}</span>
      {/* Focusable, as a long sentence scrolls. */}
      <p id="message" data-testid="message" role="status" tabindex={0} title={`${text} ${code}`.trim()} data-outcome={goal.state !== "done" ? "" : goal.code === SUCCESS ? "good" : "bad"}>
        <span>{text}</span> <small class="code" data-testid="message-code">{code}</small>
      </p>
      <Gate to="drive">
        <Button testid="suggestion" title={suggestion ? (askedText(JSON.stringify(suggestion.msg), state) ?? "") : ""} hidden={suggestion === null} press={() => suggestion && commands.publish(suggestion.topic, suggestion.type, suggestion.msg)}>{t("goals.instead")}</Button>
        <Button class="primary" testid="reset-fault" title={t("bar.reset_fault.title")} hidden={arm.mode !== "fault" || !connected} press={() => void commands.trigger("/arm/reset_fault")}>{t("bar.reset_fault")}</Button>
        <Button class="primary" testid="hold" title={t("bar.hold.title")} hidden={arm.mode !== "relaxed" || !connected} press={() => void commands.trigger("/arm/enable")}>{t("bar.hold")}</Button>
      </Gate>
      <Gate to="work">
        <Button class="primary" testid="confirm" title={t("bar.confirm.title")} hidden={!is_waiting} press={() => commands.decide(goal.id, "approve")}>{t("bar.confirm")}</Button>
        <Button testid="discard" title={t("bar.discard.title")} hidden={!is_waiting} press={() => commands.decide(goal.id, "cancel")}>{t("bar.discard")}</Button>
      </Gate>
    </>
  );
}

export function ConnectionPill(): JSX.Element {
  const { connected, latency_ms, refused } = usePage().store.state.link;
  const latency = latency_ms === null ? t("link.connected") : `${Math.max(1, Math.round(latency_ms))} ms`;
  return (
    <span class="pill" id="link-pill" data-testid="link-pill" aria-label={t("bar.connection")} data-kind={connected ? "idle" : "off"} title={connected ? t("link.title") : t("bar.offline.disabled")}>
      {connected ? latency : refused ? t("link.refused") : t("link.reconnecting")}
    </span>
  );
}

/** Notices, which stay until their cause is gone or the user dismisses them. */
export function Notices(): JSX.Element {
  const { store } = usePage();
  const drop = (key: string): void => store.set({ notices: store.state.notices.filter((notice) => notice.key !== key) });
  const item = ({ key, text }: Notice): JSX.Element => <li key={key}><span>{text}</span><SignButton sign="×" testid={`drop-${key}`} label={t("bar.dismiss")} press={() => drop(key)} /></li>;
  return <ul class="notices" data-testid="notices" aria-live="assertive">{store.state.notices.map(item)}</ul>;
}
