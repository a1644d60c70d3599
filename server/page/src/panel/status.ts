import { errorCodeName, PREEMPTED, SUCCESS } from "../link/messages";
import type { ConnectionState, GoalState, State } from "../state/state";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, setText } from "./dom";

/** Label and kind of the state pill. */
export interface Pill {
  label: string;
  /** Kind of state, which sets the colour. */
  kind: "idle" | "busy" | "stopped" | "fault" | "off";
}

/** Parts of the state that the pill and the sentence depend on. */
type StatusInput = Pick<State, "link" | "arm" | "goal" | "pending_request">;

/** Return the arm's state in a word. */
export function statePill({ link, arm, goal, pending_request }: StatusInput): Pill {
  if (!link.connected) return { label: "OFFLINE", kind: "off" };
  if (arm.mode === "fault") return { label: "FAULT", kind: "fault" };
  if (arm.mode === "disconnected") return { label: "NO ARM", kind: "fault" };
  if (arm.mode === "connected") return { label: "CHECKING", kind: "off" };
  if (goal.state === "executing" || arm.mode === "moving") return { label: movingLabel(arm.course), kind: "busy" };
  if (goal.state === "planning" || pending_request === "plan") return { label: "PLANNING", kind: "busy" };
  if (arm.mode === "relaxed") return { label: "RELAXED", kind: "off" };
  if (goal.state === "done" && goal.code === PREEMPTED) return { label: "STOPPED", kind: "stopped" };
  return { label: "IDLE", kind: "idle" };
}

function movingLabel(course: string): string {
  return { paused: "PAUSED", back: "GOING BACK" }[course] ?? "EXECUTING";
}

/** Return the sentence below the pill: a fault with its remedy, else the state or result of the goal. */
export function statusText({ link, arm, goal }: StatusInput): string {
  if (link.refused) return "The server wants a token.";
  if (!link.connected) return "The server cannot be reached; the page keeps trying. What is shown is old.";
  if (arm.mode === "fault") {
    return `${arm.fault}: ${withFullStop(arm.fault_message)} ${withFullStop(arm.fault_remedy)}`.trim();
  }
  if (arm.mode === "disconnected" || arm.mode === "connected") return arm.message;
  if (goal.state === "done" && goal.code !== null && goal.code !== SUCCESS) {
    return `${errorCodeName(goal.code)} (${goal.code}): ${goal.message}`;
  }
  if (arm.mode === "relaxed") return arm.message;
  return goal.message || arm.message;
}

function withFullStop(text: string): string {
  return text === "" || /[.!?]$/.test(text) ? text : `${text}.`;
}

/** Create the pills of arm and connection, and the sentence below them. */
export function statusHeader(context: PanelContext): HTMLElement {
  const { store, commands } = context;
  const state_attributes = { class: "pill", id: "state-pill", testid: "state-pill", label: "state of the arm" };
  const state_pill = el("span", { ...state_attributes, role: "status" });
  const link_pill = el("span", { class: "pill", id: "link-pill", testid: "link-pill", label: "connection" });
  const message = el("p", { id: "message", testid: "message", role: "status" });
  const progress = el("progress", { testid: "progress", label: "how far the motion is" });
  const suggestion = button("", "suggestion", () => {
    const offered = store.state.goal.suggestion;
    if (offered) commands.publishSuggestion(offered);
  });
  const reset = button("Reset fault", "reset-fault-here", () => void commands.trigger("/arm/reset_fault"));
  const show = (state: State): void => {
    const { arm, link, goal } = state;
    reset.hidden = arm.mode !== "fault" || !link.connected;
    const { label, kind } = statePill(state);
    setText(state_pill, label);
    state_pill.dataset["kind"] = kind;
    state_pill.dataset["code"] = goal.code === null ? "" : errorCodeName(goal.code);
    setText(message, statusText(state));
    message.dataset["refused"] = String(goal.state === "done" && goal.code !== SUCCESS);
    progress.hidden = goal.state !== "executing";
    progress.value = goal.fraction;
    suggestion.hidden = goal.suggestion === null;
    setText(suggestion, `Go there instead: ${suggestionText(goal)}`);
  };
  for (const part of ["link", "arm", "goal", "pending_request"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  store.subscribe((state) => state.link, (link) => showConnection(link_pill, link));
  const pills = el("div", { class: "pills" }, state_pill, link_pill);
  const buttons = permissionFieldset(context, "drive", suggestion, reset);
  return el("header", { class: "status" }, pills, message, progress, buttons);
}

function showConnection(element: HTMLElement, { connected, latency_ms, refused }: ConnectionState): void {
  const latency = latency_ms === null ? "connected" : `${Math.max(1, Math.round(latency_ms))} ms`;
  setText(element, connected ? latency : refused ? "not let in" : "reconnecting…");
  element.dataset["kind"] = connected ? "idle" : "fault";
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
  const list = el("ul", { class: "notices", testid: "notices", role: "alert" });
  const drop = (key: string): void => store.set({ notices: store.state.notices.filter((notice) => notice.key !== key) });
  store.subscribe(
    (state) => state.notices,
    (all) => {
      const items = all.map(({ key, text }) => {
        return el("li", {}, el("span", { text }), button("×", `drop-${key}`, () => drop(key), "Put this away"));
      });
      list.replaceChildren(...items);
    },
  );
  return list;
}
