import { paced } from "../state/pace";
import type { ServoState, State } from "../state/state";
import { el, section } from "./dom";
import type { Page } from "./page";

/** diagnostic_msgs/DiagnosticStatus's levels. */
const LEVELS = ["ok", "warn", "error", "stale"];

/** Every servo's condition. */
export function servos({ store }: Page): HTMLElement {
  const body = el("tbody", { testid: "servos" });
  const heads = ["joint", "°C", "A", "load", "torque", "condition"].map((text) => el("th", { text }));
  const table = el("table", { class: "servos" }, el("thead", {}, el("tr", {}, ...heads)), body);
  const box = section("servos", "Servos", false, el("div", { class: "wide" }, table));
  const show = paced<State>(500, (state) => {
    if (box.open) body.replaceChildren(...state.servos.map(servoRow));
  });
  store.subscribe((state) => state.servos, (_, state) => show(state));
  box.addEventListener("toggle", () => show(store.state));
  return box;
}

function servoRow({ name, level, message, values }: ServoState): HTMLElement {
  const bits = values["status_bits"] ?? "0";
  const words = level === 0 ? "ok" : message;
  const condition = bits === "0" ? words : `${words} (error bits ${bits})`;
  const { temperature_c, current_a, load, torque } = values;
  const texts = [name, temperature_c, amperes(current_a), percent(load), torque, condition];
  const row = el("tr", { testid: `servo-${name}` }, ...texts.map((text) => el("td", { text: text ?? "–" })));
  row.dataset["level"] = LEVELS[level] ?? "stale";
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
