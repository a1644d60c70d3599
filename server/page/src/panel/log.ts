import { paced } from "../state/pace";
import type { LogEntry, State } from "../state/state";
import { el, section } from "./dom";
import type { Page } from "./page";

/** rcl_interfaces/Log's levels. */
const LEVELS: [number, string][] = [
  [10, "debug"],
  [20, "info"],
  [30, "warning"],
  [40, "error"],
];

/** How many entries are shown; the newest comes first. */
const SHOWN = 100;

/** The server's log, from a level on. */
export function log({ store }: Page): HTMLElement {
  const options = LEVELS.map(([level, name]) => el("option", { text: name, attributes: { value: String(level) } }));
  const level = el("select", { testid: "log-level", label: "least level that is shown" }, ...options);
  level.value = "20";
  const list = el("ol", { class: "log", testid: "log", role: "log" });
  const box = section("log", "Log", true, el("label", { class: "line" }, "From level ", level), list);
  const show = paced<State>(200, (state) => {
    if (!box.open) return;
    const entries = state.log.filter((entry) => entry.level >= Number(level.value)).slice(-SHOWN);
    list.replaceChildren(...entries.reverse().map(line));
  });
  store.subscribe((state) => state.log, (_, state) => show(state));
  level.addEventListener("change", () => show(store.state));
  box.addEventListener("toggle", () => show(store.state));
  return box;
}

function line({ stamp, level, name, text }: LogEntry): HTMLElement {
  const time = new Date(stamp * 1000).toLocaleTimeString();
  const word = LEVELS.findLast(([least]) => level >= least)?.[1] ?? "debug";
  const item = el("li", {}, el("time", { text: time }), ` ${word} `, el("span", { class: "from", text: name }), ` ${text}`);
  item.dataset["level"] = word;
  return item;
}
