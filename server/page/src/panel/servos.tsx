import type { JSX } from "preact";
import { useContext, useEffect, useRef, useState } from "preact/hooks";
import type { ServoHistoryResponse } from "../link/messages";
import { amperes, complaints, percent, servoReport, type ServoReport } from "../logic/servo-report";
import type { ServoState } from "../state/state";
import { t } from "../texts/texts";
import type { TimeChart } from "./time-chart";
import { Button, Section, Shown, TextList, usePage, useSlowState } from "./ui";

const DIAGNOSTIC_LEVELS = ["ok", "warn", "error", "stale"];

/** Time between two requests for the server's history of a servo [ms], and the time that it has [s]. */
const FETCH_PERIOD_MS = 2000;
const HISTORY_S = 600;

const MAX_EVENTS = 30;

export function ServosSection(): JSX.Element {
  const { servos, selected_servo } = useSlowState();
  const selected = servos.find(({ name }) => name === selected_servo);
  const heads = [t("servos.joint"), "°C", "A", t("servos.load"), t("servos.torque"), t("servos.condition")];
  return (
    <Section name="servos" title={t("servos.title")}>
      <p class="hint" data-testid="servos-empty" hidden={servos.length > 0}>{t("servos.empty")}</p>
      <div class="wide">
        <table class="servos" hidden={servos.length === 0}>
          <thead><tr>{heads.map((head) => <th key={head}>{head}</th>)}</tr></thead>
          <tbody data-testid="servos">{servos.map((servo) => <ServoRow key={servo.name} servo={servo} />)}</tbody>
        </table>
      </div>
      {selected && <ServoDetails key={selected.name} servo={selected} />}
    </Section>
  );
}

function ServoRow({ servo: { name, level, message, values } }: { servo: ServoState }): JSX.Element {
  const { store } = usePage();
  const is_open = store.state.selected_servo === name;
  const bits = values.status_bits ?? "0";
  const text = level === 0 ? t("servos.ok") : message;
  const condition = bits === "0" ? text : t("servos.bits", { text, bits });
  const { temperature_c, current_a, load, torque } = values;
  return (
    <tr data-testid={`servo-${name}`} data-level={DIAGNOSTIC_LEVELS[level] ?? "stale"}>
      <td><Button testid={`servo-open-${name}`} title={t("servos.open")} aria-expanded={is_open} press={() => store.set({ selected_servo: is_open ? "" : name })}>{name}</Button></td>
      {[temperature_c, amperes(current_a), percent(load), torqueText(torque), condition].map((cell, index) => <td key={index}>{cell ?? "–"}</td>)}
    </tr>
  );
}

function ServoDetails({ servo }: { servo: ServoState }): JSX.Element {
  const { store } = usePage();
  const report = servoReport(servo);
  const errors = report.errors.length === 0 ? [t("servos.errors.none")] : report.errors.map(({ kind, count }) => `${kind}: ${count}`);
  return (
    <div class="servo" data-testid="servo-details" role="region" aria-label={t("servos.details")}>
      <div class="row-head"><b data-testid="servo-title">{`${servo.name} (${servo.hardware})`}</b><Button testid="servo-close" press={() => store.set({ selected_servo: "" })}>{t("servos.close")}</Button></div>
      <p class="hint" data-testid="servo-condition">{conditionText(servo)}</p>
      <TextList kind="findings" testid="servo-advice" label={t("servos.advice")} texts={complaints(servo)} />
      <HistoryLines name={servo.name}><h4>{t("servos.errors")}</h4><TextList kind="plain" testid="servo-errors" texts={errors} /></HistoryLines>
      <h4>{t("servos.registers")}</h4>
      <Registers registers={report.registers} />
    </div>
  );
}

function conditionText({ values }: ServoState): string {
  const { voltage_v, temperature_c, current_a, load, torque } = values;
  const measured = [temperature_c && `${temperature_c} °C`, voltage_v && `${voltage_v} V`, current_a && `${amperes(current_a)} A`, load && t("servos.of_load", { load: percent(load) })];
  return [...measured.filter(Boolean), t("servos.of_torque", { torque: torqueText(torque) })].join(", ");
}

function torqueText(torque: string | undefined): string {
  return torque === "on" || torque === "off" ? t(`servos.torque.${torque}`) : t("servos.unknown");
}

function HistoryLines({ name, children }: { name: string; children: JSX.Element[] }): JSX.Element {
  const { connection, store } = usePage();
  const shown = useContext(Shown);
  const [history, setHistory] = useState<ServoHistoryResponse | null>(null);
  const [charts, setCharts] = useState<readonly TimeChart[]>([]);
  const box = useRef<HTMLDivElement>(null);
  useEffect(() => {
    // Loaded with the first servo that is looked at.
    void import("./time-chart").then(({ TimeChart: chart_class }) => {
      const created = CHARTS.map(({ key, ...look }) => new chart_class({ title: t(key), curves: [{ label: t(key), color: look.color, digits: 0 }], ...look }));
      box.current?.replaceChildren(...created.map(({ element }) => element));
      setCharts(created);
    });
    const fetch = (): void => {
      if (!store.state.link.connected || document.visibilityState === "hidden") return;
      // A server without the service has no history.
      connection.call<ServoHistoryResponse>("/arm/servo_history", { joint: name }).then(setHistory, () => undefined);
    };
    fetch();
    const timer = setInterval(fetch, FETCH_PERIOD_MS);
    return () => clearInterval(timer);
  }, []);
  useEffect(() => {
    if (!shown || history === null || box.current === null) return;
    const { time_s } = history;
    charts.forEach((chart, index) => {
      const { field, scale } = CHARTS[index]!;
      chart.draw([time_s, time_s.map((_, at) => toScale(history[field][at], scale))], [-HISTORY_S, 0]);
    });
    box.current.dataset.samples = String(time_s.length);
  }, [shown, history, charts]);
  return (
    <>
      <div ref={box} class="servo-lines" data-testid="servo-lines" />
      {children}
      <h4>{t("servos.events")}</h4>
      <TextList kind="plain" testid="servo-events" texts={(history?.events ?? []).slice(-MAX_EVENTS).reverse()} />
    </>
  );
}

/** Charts of a servo; noise of a degree or a percent must not look like a mountain. */
const CHARTS = [
  { key: "plots.temperature", field: "temperature_c", scale: 1, unit: "°C", color: "--measured", least_range: 40 },
  { key: "plots.load", field: "load", scale: 100, unit: "%", color: "--commanded", least_range: 100 },
] as const;

function toScale(value: number | null | undefined, scale: number): number | null {
  return value === null || value === undefined ? null : scale * value;
}

function Registers({ registers }: Pick<ServoReport, "registers">): JSX.Element {
  const has_expected = registers.some(({ expected }) => expected !== "");
  return (
    <table class="servos">
      <thead><tr><th>{t("servos.register")}</th><th>{t("servos.value")}</th><th hidden={!has_expected}>{t("servos.expected")}</th></tr></thead>
      <tbody data-testid="servo-registers">
        {registers.map(({ name, value, expected, differs }) => <tr key={name} data-level={differs ? "warn" : undefined}><td>{name}</td><td>{value}</td><td>{expected}</td></tr>)}
      </tbody>
    </table>
  );
}
