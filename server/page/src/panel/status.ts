import { codeName } from "../logic/codes";
import { pill, sentence } from "../logic/pill";
import type { GoalState, LinkState, State } from "../state/state";
import { button, el, write } from "./dom";
import { gated } from "./gate";
import type { Page } from "./page";

/** The pills of arm and link, and the sentence below them. */
export function status(page: Page): HTMLElement {
  const { store, orders } = page;
  const state = el("span", { class: "pill", id: "state-pill", testid: "state-pill", role: "status", label: "state of the arm" });
  const link = el("span", { class: "pill", id: "link-pill", testid: "link-pill", label: "connection" });
  const message = el("p", { id: "message", testid: "message", role: "status" });
  const progress = el("progress", { testid: "progress", label: "how far the motion is" });
  const suggestion = button("", "suggestion", () => {
    const offered = store.state.goal.suggestion;
    if (offered) orders.publishSuggestion(offered);
  });
  const reset = button("Reset fault", "reset-fault-here", () => void orders.order("/arm/reset_fault"));
  const show = (now: State): void => {
    reset.hidden = now.arm.mode !== "fault" || !now.link.connected;
    const { label, kind } = pill(now);
    write(state, label);
    state.dataset["kind"] = kind;
    state.dataset["code"] = now.goal.code === null ? "" : codeName(now.goal.code);
    write(message, sentence(now));
    message.dataset["refused"] = String(refused(now.goal));
    progress.hidden = now.goal.state !== "executing";
    progress.value = now.goal.fraction;
    suggestion.hidden = now.goal.suggestion === null;
    write(suggestion, `Go there instead: ${suggestionWords(now.goal)}`);
  };
  for (const part of ["link", "arm", "goal", "asked"] as const) {
    store.subscribe((now) => now[part], (_, now) => show(now));
  }
  store.subscribe((now) => now.link, (now) => showLink(link, now));
  const pills = el("div", { class: "pills" }, state, link);
  return el("header", { class: "status" }, pills, message, progress, gated(page, "drive", suggestion, reset));
}

function showLink(element: HTMLElement, { connected, latency_ms, refused: closed }: LinkState): void {
  const latency = latency_ms === null ? "connected" : `${Math.max(1, Math.round(latency_ms))} ms`;
  write(element, connected ? latency : closed ? "not let in" : "reconnecting…");
  element.dataset["kind"] = connected ? "idle" : "fault";
}

function refused({ state, code }: GoalState): boolean {
  return state === "done" && code !== 1;
}

function suggestionWords({ suggestion }: GoalState): string {
  const message = suggestion?.msg as { data?: string; name?: string[]; pose?: { position: Record<string, number> } } | undefined;
  if (message?.data !== undefined) return `“${message.data}”`;
  const position = message?.pose?.position;
  if (position) return `${["x", "y", "z"].map((axis) => (position[axis] ?? 0).toFixed(3)).join(", ")} m`;
  return message?.name ? message.name.join(", ") : "";
}
