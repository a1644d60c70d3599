import { HISTORY_S, ServoHistories, type ServoHistory } from "../logic/servo-history";
import { amperes, complaints, percent, servoReport, type ServoReport } from "../logic/servo-report";
import type { ServoState, State } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { button, el, setText, showList, throttle } from "./dom";
import type { TimeChart, TimeChartOptions } from "./time-chart";

/** Time between two updates [ms]; diagnostics come once a second. */
const UPDATE_PERIOD_MS = 500;

/** Time between two requests for the server's history, which has the events too [ms]. */
const FETCH_PERIOD_MS = 10_000;

/** Events that are shown, newest first. */
const MAX_EVENTS = 30;

/** Create the details of the selected servo: condition, advice, lines, errors, events and registers. */
export function servoDetails(context: PanelContext): HTMLElement {
  const { store } = context;
  const title = el("b", { testid: "servo-title" });
  const close = button(t("servos.close"), "servo-close", () => store.set({ selected_servo: "" }));
  const condition = el("p", { class: "hint", testid: "servo-condition" });
  const advice = el("ul", { class: "findings", testid: "servo-advice", label: t("servos.advice") });
  const lines = historyLines(context);
  const errors = el("ul", { class: "plain", testid: "servo-errors" });
  const registers = registerTable();
  const box = el("div", { class: "servo", testid: "servo-details", role: "region", label: t("servos.details") });
  box.append(el("div", { class: "row-head" }, title, close), condition, advice, lines.box, heading(t("servos.errors")), errors);
  box.append(heading(t("servos.events")), lines.events, heading(t("servos.registers")), registers.table);
  const show = throttle<State>(UPDATE_PERIOD_MS, (state) => {
    const servo = state.servos.find(({ name }) => name === state.selected_servo);
    box.hidden = servo === undefined;
    if (servo === undefined) return;
    const report = servoReport(servo);
    setText(title, `${servo.name} (${servo.hardware})`);
    setText(condition, conditionText(servo));
    showList(advice, complaints(servo));
    showList(errors, errorTexts(report));
    registers.show(report);
  });
  store.watch(["servos", "selected_servo"], show);
  return box;
}

function heading(text: string): HTMLElement {
  return el("h4", { text });
}

function conditionText({ values }: ServoState): string {
  const { voltage_v, temperature_c, current_a, load, torque } = values;
  const measured = [
    temperature_c && `${temperature_c} °C`,
    voltage_v && `${voltage_v} V`,
    current_a && `${amperes(current_a)} A`,
    load && t("servos.of_load", { load: percent(load) }),
  ];
  return [...measured.filter(Boolean), t("servos.of_torque", { torque: torque ?? t("servos.unknown") })].join(", ");
}

function errorTexts({ errors }: ServoReport): string[] {
  return errors.length === 0 ? [t("servos.errors.none")] : errors.map(({ kind, count }) => `${kind}: ${count}`);
}

function historyLines({ store, servoHistory }: PanelContext): { box: HTMLElement; events: HTMLElement } {
  const box = el("div", { class: "servo-lines", testid: "servo-lines" });
  const events = el("ul", { class: "plain", testid: "servo-events" });
  const histories = new ServoHistories();
  const charts: TimeChart[] = [];
  // Loaded with the first servo that is looked at.
  const load = async (): Promise<void> => {
    const { TimeChart: chart_class } = await import("./time-chart");
    if (charts.length > 0) return;
    charts.push(...chartOptions().map((options) => new chart_class(options)));
    box.replaceChildren(...charts.map(({ element }) => element));
    draw(store.state);
  };
  const now_s = (): number => performance.now() / 1000;
  const draw = throttle<State>(UPDATE_PERIOD_MS, ({ selected_servo, servos }) => {
    if (selected_servo === "" || box.clientWidth === 0 || !servos.some(({ name }) => name === selected_servo)) return;
    if (charts.length === 0) return void load();
    const [times = [], ...curves] = histories.columns(selected_servo, now_s());
    charts.forEach((chart, index) => chart.draw([times, curves[index] ?? []], [-HISTORY_S, 0]));
    box.dataset["samples"] = String(times.length);
  });
  const fetch = async (): Promise<void> => {
    const { selected_servo: name, link } = store.state;
    if (name === "" || !link.connected || document.visibilityState === "hidden") return;
    const history: ServoHistory | null = await servoHistory(name);
    if (history === null || store.state.selected_servo !== name) return;
    histories.replace(name, history, now_s());
    showList(events, history.events.slice(-MAX_EVENTS).reverse());
    draw(store.state);
  };
  store.subscribe(
    (state) => state.servos,
    (servos, state) => {
      histories.record(servos, now_s());
      draw(state);
    },
  );
  store.subscribe(
    (state) => state.selected_servo,
    (_, state) => {
      events.replaceChildren();
      draw(state);
      void fetch();
    },
  );
  setInterval(() => void fetch(), FETCH_PERIOD_MS);
  return { box, events };
}

/** Return the options of the charts; noise of a degree or a percent must not look like a mountain. */
function chartOptions(): TimeChartOptions[] {
  const [temperature, load] = [t("servos.temperature"), t("servos.load_percent")];
  return [
    { title: temperature, unit: "°C", curves: [{ label: temperature, color: "--measured", digits: 0 }], least_range: 40 },
    { title: load, unit: "%", curves: [{ label: load, color: "--commanded", digits: 0 }], least_range: 100 },
  ];
}

function registerTable(): { table: HTMLElement; show: (report: ServoReport) => void } {
  const body = el("tbody", { testid: "servo-registers" });
  const heads = [t("servos.register"), t("servos.value"), t("servos.expected")].map((text) => el("th", { text }));
  const table = el("table", { class: "servos" }, el("thead", {}, el("tr", {}, ...heads)), body);
  const expected_head = heads.at(-1);
  let shown = "";
  const show = ({ registers }: ServoReport): void => {
    const key = JSON.stringify(registers);
    // The same registers are left alone, so that their text can be selected.
    if (key === shown) return;
    shown = key;
    if (expected_head) expected_head.hidden = registers.every(({ expected }) => expected === "");
    body.replaceChildren(
      ...registers.map(({ name, value, expected, differs }) => {
        const row = el("tr", {}, ...[name, value, expected].map((text) => el("td", { text })));
        if (differs) row.dataset["level"] = "warn";
        return row;
      }),
    );
  };
  return { table, show };
}
