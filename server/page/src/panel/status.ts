import { errorCodeName, PREEMPTED, SUCCESS } from "../link/messages";
import type { ConnectionState, GoalState, Notice, State } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, capitalized, el, keyedList, setText } from "./dom";

/** Label and kind of the state pill. */
export interface Pill {
  label: string;
  /** Kind of state, which sets the colour. */
  kind: "idle" | "busy" | "stopped" | "fault" | "off";
}

/** Parts of the state that the pill and the sentence depend on. */
type StatusInput = Pick<State, "link" | "arm" | "goal" | "pending_request">;

/** Return the arm's state in a word. */
export function statePill(state: StatusInput): Pill {
  const [name, kind] = stateName(state);
  return { label: t(`state.${name}` as TextKey), kind };
}

function stateName({ link, arm, goal, pending_request }: StatusInput): [string, Pill["kind"]] {
  if (!link.connected) return [arm.mode === "" && !link.refused ? "connecting" : "offline", "off"];
  if (isBeingChecked(arm)) return ["checking", "off"];
  if (arm.mode === "fault") return ["fault", "fault"];
  if (arm.mode === "disconnected") return ["no_arm", "fault"];
  if (goal.state === "executing" || arm.mode === "moving") return [courseName(arm.course), "busy"];
  if (isAwaitingConfirmation(goal)) return ["waiting", "busy"];
  if (goal.state === "planning" || pending_request === "plan") return ["planning", "busy"];
  if (arm.mode === "relaxed") return ["relaxed", "off"];
  if (goal.state === "done" && goal.code === PREEMPTED) return ["stopped", "stopped"];
  return ["idle", "idle"];
}

/** Return true for a goal that is planned and waits for a person; a plan of this page has no id. */
export function isAwaitingConfirmation({ id, state }: GoalState): boolean {
  return state === "planned" && id !== "";
}

/** Return true before the server has told the arm's mode, and while it starts and checks the arm, which is no fault. */
function isBeingChecked({ mode, reason }: State["arm"]): boolean {
  return mode === "" || mode === "connected" || (mode === "disconnected" && reason.includes("is starting"));
}

function courseName(course: string): string {
  return { paused: "paused", back: "back" }[course] ?? "executing";
}

/** Return the sentence beside the pill: what is the matter and what to do, else the state or result of the goal. */
export function statusText({ link, arm, goal }: StatusInput): string {
  if (link.refused) return t("status.token");
  if (!link.connected) return t(arm.mode === "" ? "status.connecting" : "status.offline");
  if (isBeingChecked(arm)) return `${t("status.checking")} ${sentence(arm.reason)}`.trim();
  if (arm.mode === "fault") return `${sentence(arm.fault_message)} ${sentence(arm.fault_remedy)}`.trim();
  if (arm.mode === "disconnected") return `${t("status.no_arm")} ${sentence(arm.reason)}`.trim();
  if (goal.state === "done" && goal.code !== null && goal.code !== SUCCESS) return sentence(goal.message);
  if (arm.mode === "relaxed") return t("status.relaxed");
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

/** Return a text of the server as a sentence. */
function sentence(text: string): string {
  return text === "" || /[.!?…]$/.test(text) ? capitalized(text) : `${capitalized(text)}.`;
}

/** Create the arm's state in a word and in a sentence, and the button that helps: the only one for its cause. */
export function statusBar(context: PanelContext): HTMLElement[] {
  const { store, commands } = context;
  const attributes = { class: "pill", id: "state-pill", testid: "state-pill", label: t("bar.state") };
  const state_pill = el("span", { ...attributes, role: "status" });
  const text = el("span");
  const code = el("small", { class: "code", testid: "message-code" });
  // Focusable, as a long sentence scrolls.
  const readable = { id: "message", testid: "message", role: "status", attributes: { tabindex: "0" } };
  const message = el("p", readable, text, " ", code);
  const suggestion = button("", "suggestion", () => {
    const offered = store.state.goal.suggestion;
    if (offered) commands.publishSuggestion(offered);
  });
  const trigger = (service: string) => (): void => void commands.trigger(service);
  const reset = button(t("bar.reset_fault"), "reset-fault", trigger("/arm/reset_fault"), t("bar.reset_fault.title"));
  const hold = button(t("bar.hold"), "hold", trigger("/arm/enable"), t("bar.hold.title"));
  const confirm = button(t("bar.confirm"), "confirm", () => commands.approveGoal(store.state.goal.id), t("bar.confirm.title"));
  const discard = button(t("bar.discard"), "discard", () => commands.cancelGoal(store.state.goal.id), t("bar.discard.title"));
  for (const helping of [reset, hold, confirm]) helping.classList.add("primary");
  const show = (state: State): void => {
    const { arm, link, goal } = state;
    reset.hidden = arm.mode !== "fault" || !link.connected;
    hold.hidden = arm.mode !== "relaxed" || !link.connected;
    confirm.hidden = discard.hidden = !isAwaitingConfirmation(goal) || !link.connected;
    const { label, kind } = statePill(state);
    setText(state_pill, label);
    document.title = t("bar.title", { state: label });
    state_pill.dataset["kind"] = kind;
    state_pill.dataset["code"] = goal.code === null ? "" : errorCodeName(goal.code);
    setText(text, statusText(state));
    setText(code, statusCode(state));
    message.title = `${statusText(state)} ${statusCode(state)}`.trim();
    message.dataset["outcome"] = goal.state !== "done" ? "" : goal.code === SUCCESS ? "good" : "bad";
    suggestion.hidden = goal.suggestion === null;
    setText(suggestion, t("bar.suggestion", { place: suggestionText(goal) }));
  };
  store.watch(["link", "arm", "goal", "pending_request"], show);
  const confirmation = permissionFieldset(context, "work", confirm, discard);
  return [state_pill, message, permissionFieldset(context, "drive", suggestion, reset, hold), confirmation];
}

/** Create the pill of the connection with its round-trip time. */
export function connectionPill({ store }: PanelContext): HTMLElement {
  const pill = el("span", { class: "pill", id: "link-pill", testid: "link-pill", label: t("bar.connection") });
  store.subscribe((state) => state.link, (link) => showConnection(pill, link));
  return pill;
}

function showConnection(element: HTMLElement, { connected, latency_ms, refused }: ConnectionState): void {
  const latency = latency_ms === null ? t("link.connected") : `${Math.max(1, Math.round(latency_ms))} ms`;
  setText(element, connected ? latency : refused ? t("link.refused") : t("link.reconnecting"));
  element.dataset["kind"] = connected ? "idle" : "off";
  element.title = connected ? t("link.title") : t("bar.offline.disabled");
}

/** Message of a suggested goal: std_msgs/String, geometry_msgs/PoseStamped or sensor_msgs/JointState. */
interface SuggestedMessage {
  data?: string;
  name?: string[];
  pose?: { position: Record<string, number> };
}

function suggestionText({ suggestion }: GoalState): string {
  const message = suggestion?.msg as SuggestedMessage | undefined;
  if (message?.data !== undefined) return `“${message.data}”`;
  const position = message?.pose?.position;
  if (position) return `${["x", "y", "z"].map((axis) => (position[axis] ?? 0).toFixed(3)).join(", ")} m`;
  return message?.name ? message.name.join(", ") : "";
}

/** Create the list of notices, which stay until their cause is gone or the user dismisses them. */
export function noticeList({ store }: PanelContext): HTMLElement {
  const list = el("ul", { class: "notices", testid: "notices", attributes: { "aria-live": "assertive" } });
  const drop = (key: string): void => store.set({ notices: store.state.notices.filter((notice) => notice.key !== key) });
  const showItems = keyedList<Notice>(list, ({ key }) => key, ({ key }) => {
    const text = el("span");
    const element = el("li", {}, text, button("×", `drop-${key}`, () => drop(key), t("bar.dismiss")));
    return { element, show: (notice) => setText(text, notice.text) };
  });
  store.subscribe((state) => state.notices, showItems);
  return list;
}
