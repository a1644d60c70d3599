import type { LogEntry, ServoState, State } from "../state/state";
import type { PanelContext } from "./context";
import { el, section, throttle } from "./dom";

/** Levels of diagnostic_msgs/DiagnosticStatus. */
const DIAGNOSTIC_LEVELS = ["ok", "warn", "error", "stale"];

/** Create the table of the servos' condition. */
export function servosSection({ store }: PanelContext): HTMLElement {
  const body = el("tbody", { testid: "servos" });
  const heads = ["joint", "°C", "A", "load", "torque", "condition"].map((text) => el("th", { text }));
  const table = el("table", { class: "servos" }, el("thead", {}, el("tr", {}, ...heads)), body);
  const box = section("servos", "Servos", false, el("div", { class: "wide" }, table));
  const show = throttle<State>(500, (state) => {
    if (box.open) body.replaceChildren(...state.servos.map(servoRow));
  });
  store.subscribe((state) => state.servos, (_, state) => show(state));
  box.addEventListener("toggle", () => show(store.state));
  return box;
}

function servoRow({ name, level, message, values }: ServoState): HTMLElement {
  const bits = values["status_bits"] ?? "0";
  const text = level === 0 ? "ok" : message;
  const condition = bits === "0" ? text : `${text} (error bits ${bits})`;
  const { temperature_c, current_a, load, torque } = values;
  const texts = [name, temperature_c, amperes(current_a), percent(load), torque, condition];
  const row = el("tr", { testid: `servo-${name}` }, ...texts.map((text) => el("td", { text: text ?? "–" })));
  row.dataset["level"] = DIAGNOSTIC_LEVELS[level] ?? "stale";
  return row;
}

function amperes(text: string | undefined): string {
  const value = Number(text ?? Number.NaN);
  return Number.isFinite(value) ? Math.abs(value).toFixed(2) : "–";
}

function percent(text: string | undefined): string {
  const value = Number(text ?? Number.NaN);
  return Number.isFinite(value) ? `${Math.round(100 * value)} %` : "–";
}

/** Levels of rcl_interfaces/Log. */
const LOG_LEVELS: [number, string][] = [
  [10, "debug"],
  [20, "info"],
  [30, "warning"],
  [40, "error"],
];

/** Number of log entries that are shown, newest first. */
const MAX_SHOWN_ENTRIES = 100;

/** Create the section with the server's log, from a level on. */
export function logSection({ store }: PanelContext): HTMLElement {
  const options = LOG_LEVELS.map(([level, name]) => el("option", { text: name, attributes: { value: String(level) } }));
  const level = el("select", { testid: "log-level", label: "least level that is shown" }, ...options);
  level.value = "20";
  const list = el("ol", { class: "log", testid: "log", role: "log" });
  const box = section("log", "Log", true, el("label", { class: "line" }, "From level ", level), list);
  const show = throttle<State>(200, (state) => {
    if (!box.open) return;
    const entries = state.log.filter((entry) => entry.level >= Number(level.value)).slice(-MAX_SHOWN_ENTRIES);
    list.replaceChildren(...entries.reverse().map(logItem));
  });
  store.subscribe((state) => state.log, (_, state) => show(state));
  level.addEventListener("change", () => show(store.state));
  box.addEventListener("toggle", () => show(store.state));
  return box;
}

function logItem({ stamp, level, name, text }: LogEntry): HTMLElement {
  const time = new Date(stamp * 1000).toLocaleTimeString();
  const level_name = LOG_LEVELS.findLast(([least]) => level >= least)?.[1] ?? "debug";
  const source = el("span", { class: "from", text: name });
  const item = el("li", {}, el("time", { text: time }), ` ${level_name} `, source, ` ${text}`);
  item.dataset["level"] = level_name;
  return item;
}
