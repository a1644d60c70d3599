import "./plots.css";
import type { JSX } from "preact";
import { useContext, useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { csv, curveUnit, JointSamples, QUANTITIES, type Column, type Quantity } from "../logic/joint-samples";
import { bounds, MAX_SPAN_S, panned, zoomed, type Extent, type TimeWindow } from "../logic/time-window";
import { loadPreference, storePreference } from "../state/preferences";
import { t } from "../texts/texts";
import { saveFile } from "./files";
import type { TimeChart } from "./time-chart";
import { Button, Line, Select, Shown, SignButton, Tick, usePage, useSlowState } from "./ui";

/** Least number of points of a curve: a chart that is laid out later has no width yet. */
const MIN_POINTS = 200;

/** Colours of joints; a ninth joint has that of the first. */
const COLORS = 8;

/** Joints that are chosen at first: those of a common arm, without making the charts a tangle. */
const FIRST_JOINTS = 3;

const SPANS_S = [5, 10, 20, 60, 300, MAX_SPAN_S];

/** Quantities that share a chart: what is commanded beside what is measured. */
const CHARTS: Quantity[][] = [["position", "goal"], ["error"], ["velocity"], ["load"], ["temperature"]];

/** Least range of each chart in radians, metres, shares or degrees Celsius: noise must not look like a motion. */
const LEAST_RANGES: Record<Quantity, number> = { position: 0.02, goal: 0.02, error: 0.01, velocity: 0.05, load: 0.1, temperature: 10 };

/** Plots of any of the joints' quantities over the last minutes, with the choice of them and of the time that is shown. */
export function Plots(): JSX.Element {
  const { store } = usePage();
  const state = useSlowState();
  const shown = useContext(Shown);
  const [samples] = useState(() => new JointSamples());
  const [view, show] = useState<TimeWindow>({ span_s: 20, end_s: null });
  const [joints, setJoints] = useState(() => loadChoice("plot-joints"));
  const [quantities, setQuantities] = useState(() => loadChoice("plot-quantities") ?? ["position", "goal"]);
  // Loaded when the panel is shown first.
  const [chart_class, setChartClass] = useState<{ create: typeof TimeChart } | null>(null);
  const charts = useRef<readonly { chart: TimeChart; columns: Column[] }[]>([]);
  const [, resize] = useState(0);
  const [cursor] = useState({ share: 1 });
  const host = useRef<HTMLDivElement>(null);
  const recorded = (): Extent => {
    const { times_s } = samples.series;
    return { oldest_s: times_s[0] ?? Number.NaN, newest_s: times_s.at(-1) ?? Number.NaN };
  };
  const extent = recorded();
  // Charts and pointers read it outside of the drawing.
  const newest = useRef({ view, extent });
  newest.current = { view, extent };
  const zoom = (factor: number, about_s: number): void => show((before) => zoomed(before, factor, about_s, newest.current.extent));
  const pan = (by_s: number): void => show((before) => panned(before, by_s, newest.current.extent));
  const toggle = (): void => show({ ...view, end_s: view.end_s === null ? extent.newest_s : null });
  const [begin_s, end_s] = bounds(view, extent);
  const zero_s = view.end_s ?? extent.newest_s;
  const zoomAboutMiddle = (factor: number): void => zoom(factor, (begin_s + end_s) / 2);

  const { names } = samples;
  const isChosen = (joint: string): boolean => joints?.includes(joint) ?? names.indexOf(joint) < FIRST_JOINTS;
  const colorOf = (joint: string): string => `--curve-${names.indexOf(joint) % COLORS}`;
  const chosen: Column[][] = CHARTS.flatMap((shared) => {
    const wanted = shared.filter((quantity) => quantities.includes(quantity));
    const columns = names.filter(isChosen).flatMap((joint) => wanted.map((quantity) => ({ joint, quantity, unit: curveUnit(state, joint, quantity) })));
    return [...new Set(columns.map(({ unit }) => unit.name))].map((name) => columns.filter(({ unit }) => unit.name === name));
  });
  const createChart = (create: typeof TimeChart, columns: Column[]): TimeChart => {
    const first = columns[0] as Column;
    const titles = [...new Set(columns.map(({ quantity }) => t(`plots.${quantity}`)))];
    return new create({
      title: titles.join(", "),
      unit: first.unit.name,
      curves: columns.map(({ joint, quantity, unit }) => ({
        label: titles.length > 1 ? `${joint} (${t(`plots.${quantity}`)})` : joint,
        color: colorOf(joint),
        dashed: quantity === "goal",
        digits: unit.digits,
      })),
      least_range: LEAST_RANGES[first.quantity] * first.unit.scale,
      zoom: (factor, about_s) => zoom(factor, (newest.current.view.end_s ?? newest.current.extent.newest_s) + about_s),
      pan,
    });
  };
  useEffect(() => {
    const end = store.subscribe((each) => each.joints, (_, each) => samples.record(each));
    const observer = new ResizeObserver(() => resize((count) => count + 1));
    if (host.current) observer.observe(host.current);
    return () => {
      end();
      observer.disconnect();
    };
  }, []);
  useEffect(() => void (shown && void import("./time-chart").then(({ TimeChart: create }) => setChartClass({ create }))), [shown]);
  // Other charts where others are wanted.
  useLayoutEffect(() => {
    const created = chart_class === null ? [] : chosen.map((columns) => ({ chart: createChart(chart_class.create, columns), columns }));
    host.current?.replaceChildren(...created.map(({ chart }) => chart.element));
    charts.current = created;
    return () => created.forEach(({ chart }) => chart.destroy());
  }, [chart_class, JSON.stringify(chosen)]);
  useLayoutEffect(() => {
    if (!shown || host.current === null) return;
    // More than one for each pixel cannot be told apart, and each costs time.
    const max_points = Math.max(MIN_POINTS, host.current.clientWidth);
    host.current.dataset.draws = String(Number(host.current.dataset.draws ?? 0) + 1);
    charts.current.forEach(({ chart, columns }) => {
      const curves = columns.map(({ joint, quantity }) => samples.curve(joint, quantity));
      const [times = [], ...rows] = samples.series.span(begin_s, end_s, curves, max_points);
      const scaled = rows.map((row, at) => row.map((value) => (value === null ? null : value * (columns[at]?.unit.scale ?? 1))));
      chart.draw([times.map((time_s) => (time_s ?? 0) - zero_s), ...scaled], [begin_s - zero_s, end_s - zero_s]);
    });
  });

  const onKey = (event: KeyboardEvent): void => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const moveCursor = (by: number): void => {
      cursor.share = Math.min(Math.max(cursor.share + by, 0), 1);
      for (const { chart } of charts.current) chart.setCursor(cursor.share);
    };
    const actions: Record<string, () => void> = {
      ArrowLeft: () => (event.shiftKey ? moveCursor(-0.02) : pan(-view.span_s / 10)),
      ArrowRight: () => (event.shiftKey ? moveCursor(0.02) : pan(view.span_s / 10)),
      "+": () => zoomAboutMiddle(0.5),
      "-": () => zoomAboutMiddle(2),
      " ": toggle,
      End: () => show({ ...view, end_s: null }),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    // The jog's keys must not move the arm meanwhile.
    event.stopPropagation();
    action();
  };
  const chooseJoint = (name: string, on: boolean): void => {
    const next = names.filter((other) => (other === name ? on : isChosen(other)));
    storePreference("plot-joints", next.join());
    setJoints(next);
  };
  const chooseQuantity = (quantity: string, on: boolean): void => {
    const next = [...quantities.filter((other) => other !== quantity), ...(on ? [quantity] : [])];
    storePreference("plot-quantities", next.join());
    setQuantities(next);
  };
  const saveCsv = (): void => {
    const [from_s, to_s] = bounds(view, recorded()); // newer than what is drawn
    const stamp = new Date(to_s * 1000).toISOString().replace(/[:.]/g, "-");
    saveFile(`armbridge-${stamp}.csv`, "text/csv", csv(samples, chosen.flat(), from_s, to_s));
  };
  const is_live = view.end_s === null;
  const spans_s = [...new Set([...SPANS_S, view.span_s])].sort((one, other) => one - other);
  const reason = names.length === 0 ? t("plots.empty") : chosen.length === 0 ? t("plots.nothing_chosen") : "";
  return (
    <div class="plots" data-testid="section-plots">
      <fieldset class="choices" data-testid="plot-joints">
        <legend>{t("plots.joints")}</legend>
        {names.map((name) => (
          <Tick key={name} kind="choice" testid={`plot-joint-${name}`} checked={isChosen(name)} take={(on) => chooseJoint(name, on)} text={<><i class="swatch" style={{ background: `var(${colorOf(name)})` }} />{name}</>} />
        ))}
      </fieldset>
      <fieldset class="choices" data-testid="plot-quantities">
        <legend>{t("plots.quantities")}</legend>
        {QUANTITIES.map((each) => <Tick key={each} kind="choice" testid={`plot-quantity-${each}`} checked={quantities.includes(each)} take={(on) => chooseQuantity(each, on)} text={t(`plots.${each}`)} />)}
      </fieldset>
      <div class="buttons">
        <Button testid="plot-pause" aria-pressed={!is_live} press={toggle}>{is_live ? `❚❚ ${t("plots.pause")}` : `▶ ${t("plots.live")}`}</Button>
        <SignButton sign="+" testid="plot-zoom-in" label={t("plots.zoom_in")} press={() => zoomAboutMiddle(0.5)} />
        <SignButton sign="−" testid="plot-zoom-out" label={t("plots.zoom_out")} press={() => zoomAboutMiddle(2)} />
        <Line text={t("plots.span")}><Select testid="plot-span" value={String(view.span_s)} options={spans_s.map((span_s) => [String(span_s), spanText(span_s)])} take={(span_s) => show({ ...view, span_s: Number(span_s) })} /></Line>
        <Button testid="plot-csv" title={t("plots.csv.title")} disabled={chosen.length === 0} press={saveCsv}>{t("plots.csv")}</Button>
      </div>
      <p class="hint" data-testid="plot-empty" hidden={reason === ""}>{reason}</p>
      <div ref={host} class="time-charts" data-testid="plot" role="group" tabindex={0} aria-label={t("plots.label")} aria-describedby="plot-keys" data-samples={chosen.length === 0 ? 0 : samples.series.times_s.length} data-span-s={view.span_s} data-end-s={view.end_s ?? ""} onKeyDown={onKey} />
      <p class="hint" id="plot-keys">{t("plots.keys")}</p>
    </div>
  );
}

function spanText(span_s: number): string {
  return span_s >= 60 && span_s % 60 === 0 ? `${span_s / 60} min` : `${Number(span_s.toPrecision(3))} s`;
}

function loadChoice(key: string): string[] | null {
  const stored = loadPreference(key, "?");
  return stored === "?" ? null : stored.split(",").filter((name) => name !== "");
}
