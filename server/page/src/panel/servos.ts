import { amperes, percent } from "../logic/servo-report";
import type { ServoState, State } from "../state/state";
import { t } from "../texts/texts";
import type { PageStore } from "../state/store";
import type { PanelContext } from "./context";
import { isShown, whenShown } from "./shown";
import { button, el, keyedList, section, setText, throttle, type ListItem } from "./dom";
import { servoDetails } from "./servo-details";

/** Levels of diagnostic_msgs/DiagnosticStatus. */
const DIAGNOSTIC_LEVELS = ["ok", "warn", "error", "stale"];

/** Time between two updates [ms]; diagnostics come once a second. */
const UPDATE_PERIOD_MS = 500;

/** Create the table of the servos' condition, each of which opens its details. */
export function servosSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const body = el("tbody", { testid: "servos" });
  const heads = [t("servos.joint"), "°C", "A", t("servos.load"), t("servos.torque"), t("servos.condition")].map((text) => el("th", { text }));
  const table = el("table", { class: "servos" }, el("thead", {}, el("tr", {}, ...heads)), body);
  const details = servoDetails(context);
  const empty = el("p", { class: "hint", testid: "servos-empty", text: t("servos.empty") });
  const box = section("servos", t("servos.title"), true, empty, el("div", { class: "wide" }, table), details);
  const showRows = keyedList<ServoState>(body, ({ name }) => name, ({ name }) => servoRow(store, name));
  const show = throttle<State>(UPDATE_PERIOD_MS, ({ servos }) => {
    if (!isShown(box)) return;
    empty.hidden = servos.length > 0;
    table.hidden = servos.length === 0;
    showRows(servos);
  });
  store.watch(["servos", "selected_servo"], show);
  whenShown(box, () => show(store.state));
  return box;
}

function servoRow(store: PageStore, name: string): ListItem<ServoState> {
  const select = (): void => store.set({ selected_servo: store.state.selected_servo === name ? "" : name });
  const open = button(name, `servo-open-${name}`, select, t("servos.open"));
  const cells = Array.from({ length: 5 }, () => el("td"));
  const element = el("tr", { testid: `servo-${name}` }, el("td", {}, open), ...cells);
  const show = ({ level, message, values }: ServoState): void => {
    const bits = values["status_bits"] ?? "0";
    const text = level === 0 ? t("servos.ok") : message;
    const condition = bits === "0" ? text : t("servos.bits", { text, bits });
    const { temperature_c, current_a, load, torque } = values;
    const texts = [temperature_c, amperes(current_a), percent(load), torque, condition];
    cells.forEach((cell, index) => setText(cell, texts[index] ?? "–"));
    element.dataset["level"] = DIAGNOSTIC_LEVELS[level] ?? "stale";
    open.setAttribute("aria-expanded", String(store.state.selected_servo === name));
  };
  return { element, show };
}
