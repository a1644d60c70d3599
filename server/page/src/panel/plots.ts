import "./plots.css";
import { csv, curveUnit, JointSamples, QUANTITIES, type Column, type Quantity } from "../logic/joint-samples";
import { bounds, live, MAX_SPAN_S, panned, paused, zoomed, type Extent, type TimeWindow } from "../logic/time-window";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { isShown, whenShown } from "./shown";
import { button, el, loadPreference, option, setText, storePreference, throttle } from "./dom";
import { saveFile } from "./files";
import type { TimeChart } from "./time-chart";

/** Least time between two drawings [ms]: each takes some milliseconds, and five a second look live. */
const REDRAW_PERIOD_MS = 200;

/** Most points of a curve that are drawn: more than one for each pixel cannot be told apart. */
const MAX_POINTS = 1200;

/** Colours of joints; a ninth joint has that of the first. */
const COLORS = 8;

/** Joints that are chosen at first: those of a common arm, without making the charts a tangle. */
const FIRST_JOINTS = 3;

/** Spans that are offered [s]. */
const SPANS_S = [5, 10, 20, 60, 300, MAX_SPAN_S];

/** Quantities that share a chart: what is commanded beside what is measured. */
const CHARTS: Quantity[][] = [["position", "goal"], ["error"], ["velocity"], ["load"], ["temperature"]];

/** Least range of each chart in radians, metres, shares or degrees Celsius: noise must not look like a motion. */
const LEAST_RANGES: Record<Quantity, number> = { position: 0.02, goal: 0.02, error: 0.01, velocity: 0.05, load: 0.1, temperature: 10 };

/** Create the plots of any of the joints' quantities over the last minutes. */
export function plotsSection(context: PanelContext): HTMLElement {
  return new Plots(context).element;
}

/** Charts with the choice of joints and quantities, and of the time that they show. */
class Plots {
  readonly element: HTMLElement;
  private readonly samples = new JointSamples();
  private window: TimeWindow = { span_s: 20, end_s: null };
  private joints: Set<string> | null = loadChoice("plot-joints");
  private quantities = loadChoice("plot-quantities") ?? new Set<string>(["position", "goal"]);
  private charts: { chart: TimeChart; columns: Column[] }[] = [];
  /** Loaded when the panel is shown first. */
  private chart_class: typeof TimeChart | null = null;
  private drawn_as = "";
  private cursor_share = 1;
  private readonly jointChoice = el("fieldset", { class: "choices", testid: "plot-joints" });
  private readonly quantityChoice = el("fieldset", { class: "choices", testid: "plot-quantities" });
  private readonly host = el("div", { class: "time-charts", testid: "plot", role: "group" });
  private readonly empty = el("p", { class: "hint", testid: "plot-empty" });
  private readonly halt = button(`❚❚ ${t("plots.pause")}`, "plot-pause", () => this.toggle());
  private readonly save = button(t("plots.csv"), "plot-csv", () => this.saveCsv(), t("plots.csv.title"));
  private readonly span = el("select", { testid: "plot-span" });
  private readonly request = throttle<State>(REDRAW_PERIOD_MS, (state) => this.draw(state));

  constructor(private readonly context: PanelContext) {
    const { store } = context;
    this.host.tabIndex = 0;
    this.host.setAttribute("aria-label", t("plots.label"));
    this.host.setAttribute("aria-describedby", "plot-keys");
    this.host.addEventListener("keydown", (event) => this.onKey(event));
    this.span.addEventListener("change", () => this.show({ ...this.window, span_s: Number(this.span.value) }));
    const buttons = [this.zoomButton("+", 0.5, t("plots.zoom_in")), this.zoomButton("−", 2, t("plots.zoom_out"))];
    const tools = el("div", { class: "buttons" }, this.halt, ...buttons, el("label", { class: "line" }, `${t("plots.span")} `, this.span), this.save);
    const keys = el("p", { class: "hint", id: "plot-keys", text: t("plots.keys") });
    this.element = el("div", { class: "plots", testid: "section-plots" }, this.jointChoice, this.quantityChoice, tools, this.empty, this.host, keys);
    store.subscribe(
      (state) => state.joints,
      (_, state) => {
        this.samples.record(state);
        // A halted picture stays as it is.
        if (this.window.end_s === null) this.request(state);
      },
    );
    store.subscribe((state) => state.settings.units, (_, state) => this.request(state));
    whenShown(this.host, () => this.request(store.state));
    new ResizeObserver(() => this.request(store.state)).observe(this.host);
  }

  private get extent(): Extent {
    return { oldest_s: this.samples.ring.oldest_s, newest_s: this.samples.ring.newest_s };
  }

  private show(window: TimeWindow): void {
    this.window = window;
    this.request(this.context.store.state);
  }

  private toggle(): void {
    this.show(this.window.end_s === null ? paused(this.window, this.extent) : live(this.window));
  }

  private zoomButton(text: string, factor: number, title: string): HTMLButtonElement {
    const zoom = button(text, factor < 1 ? "plot-zoom-in" : "plot-zoom-out", () => this.zoomAboutMiddle(factor), title);
    zoom.setAttribute("aria-label", title);
    return zoom;
  }

  private zoomAboutMiddle(factor: number): void {
    const [begin_s, end_s] = bounds(this.window, this.extent);
    this.show(zoomed(this.window, factor, (begin_s + end_s) / 2, this.extent));
  }

  private onKey(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tenth_s = this.window.span_s / 10;
    const actions: Record<string, () => void> = {
      ArrowLeft: () => (event.shiftKey ? this.moveCursor(-0.02) : this.show(panned(this.window, -tenth_s, this.extent))),
      ArrowRight: () => (event.shiftKey ? this.moveCursor(0.02) : this.show(panned(this.window, tenth_s, this.extent))),
      "+": () => this.zoomAboutMiddle(0.5),
      "-": () => this.zoomAboutMiddle(2),
      " ": () => this.toggle(),
      End: () => this.show(live(this.window)),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    // The jog's keys must not move the arm meanwhile.
    event.stopPropagation();
    action();
  }

  private moveCursor(by: number): void {
    this.cursor_share = Math.min(Math.max(this.cursor_share + by, 0), 1);
    for (const { chart } of this.charts) chart.setCursor(this.cursor_share);
  }

  private draw(state: State): void {
    if (!isShown(this.host)) return;
    if (this.chart_class === null) return void this.load();
    this.showChoices(state);
    this.showTools();
    this.arrangeCharts(state);
    const [begin_s, end_s] = bounds(this.window, this.extent);
    const zero_s = this.window.end_s ?? this.extent.newest_s;
    for (const { chart, columns } of this.charts) {
      const curves = columns.map(({ joint, quantity }) => this.samples.curve(joint, quantity));
      const [times = [], ...rows] = this.samples.ring.span(begin_s, end_s, curves, MAX_POINTS);
      const scaled = rows.map((row, index) => {
        const scale = columns[index]?.unit.scale ?? 1;
        return row.map((value) => (value === null ? null : value * scale));
      });
      chart.draw([times.map((time_s) => (time_s ?? 0) - zero_s), ...scaled], [begin_s - zero_s, end_s - zero_s]);
    }
    this.host.dataset["samples"] = String(this.charts.length === 0 ? 0 : this.samples.ring.count);
    this.host.dataset["draws"] = String(Number(this.host.dataset["draws"] ?? 0) + 1);
    this.host.dataset["spanS"] = String(this.window.span_s);
    this.host.dataset["endS"] = String(this.window.end_s ?? "");
  }

  private async load(): Promise<void> {
    this.chart_class = (await import("./time-chart")).TimeChart;
    this.request(this.context.store.state);
  }

  private showTools(): void {
    const is_live = this.window.end_s === null;
    setText(this.halt, is_live ? `❚❚ ${t("plots.pause")}` : `▶ ${t("plots.live")}`);
    this.halt.setAttribute("aria-pressed", String(!is_live));
    const spans = [...new Set([...SPANS_S, this.window.span_s])].sort((one, other) => one - other);
    if (spans.join() !== [...this.span.options].map(({ value }) => value).join()) {
      this.span.replaceChildren(...spans.map((span_s) => option(String(span_s), spanText(span_s))));
    }
    if (document.activeElement !== this.span) this.span.value = String(this.window.span_s);
    const reason = this.samples.names.length === 0 ? t("plots.empty") : this.charts.length === 0 ? t("plots.nothing_chosen") : "";
    setText(this.empty, reason);
    this.empty.hidden = reason === "";
    this.save.disabled = this.charts.length === 0;
  }

  private chosen(): Column[][] {
    const { state } = this.context.store;
    return CHARTS.flatMap((quantities) => {
      const columns = this.samples.names.flatMap((joint) => {
        if (!this.isChosen(joint)) return [];
        const wanted = quantities.filter((quantity) => this.quantities.has(quantity));
        return wanted.map((quantity) => ({ joint, quantity, unit: curveUnit(state, joint, quantity) }));
      });
      const units = [...new Set(columns.map(({ unit }) => unit.name))];
      return units.map((name) => columns.filter(({ unit }) => unit.name === name));
    });
  }

  private isChosen(joint: string): boolean {
    return this.joints?.has(joint) ?? this.samples.names.indexOf(joint) < FIRST_JOINTS;
  }

  /** Create the charts anew where others are wanted. */
  private arrangeCharts(state: State): void {
    const wanted = this.chosen();
    const key = JSON.stringify(wanted) + state.settings.units;
    if (key === this.drawn_as) return;
    this.drawn_as = key;
    for (const { chart } of this.charts) chart.destroy();
    const { chart_class } = this;
    this.charts = chart_class === null ? [] : wanted.map((columns) => ({ chart: this.createChart(chart_class, columns), columns }));
    this.host.replaceChildren(...this.charts.map(({ chart }) => chart.element));
    this.showTools();
  }

  private createChart(chart_class: typeof TimeChart, columns: Column[]): TimeChart {
    const first = columns[0] as Column;
    const names = [...new Set(columns.map(({ quantity }) => t(`plots.${quantity}`)))];
    const curves = columns.map(({ joint, quantity, unit }) => ({
      label: names.length > 1 ? `${joint} (${t(`plots.${quantity}`)})` : joint,
      color: this.colorOf(joint),
      dashed: quantity === "goal",
      digits: unit.digits,
    }));
    const zero_s = (): number => this.window.end_s ?? this.extent.newest_s;
    return new chart_class({
      title: names.join(", "),
      unit: first.unit.name,
      curves,
      least_range: LEAST_RANGES[first.quantity] * first.unit.scale,
      zoom: (factor, about_s) => this.show(zoomed(this.window, factor, zero_s() + about_s, this.extent)),
      pan: (by_s) => this.show(panned(this.window, by_s, this.extent)),
    });
  }

  private colorOf(joint: string): string {
    return `--curve-${this.samples.names.indexOf(joint) % COLORS}`;
  }

  private showChoices({ settings }: State): void {
    const key = [...this.samples.names, settings.units].join();
    if (this.jointChoice.dataset["of"] === key) return;
    this.jointChoice.dataset["of"] = key;
    const joints = this.samples.names.map((name) => {
      const swatch = el("i", { class: "swatch" });
      swatch.style.background = `var(${this.colorOf(name)})`;
      return this.choice(`plot-joint-${name}`, name, this.isChosen(name), (on) => this.chooseJoint(name, on), swatch);
    });
    this.jointChoice.replaceChildren(el("legend", { text: t("plots.joints") }), ...joints);
    const quantities = QUANTITIES.map((quantity) => {
      const choose = (on: boolean): void => this.chooseQuantity(quantity, on);
      return this.choice(`plot-quantity-${quantity}`, t(`plots.${quantity}`), this.quantities.has(quantity), choose);
    });
    this.quantityChoice.replaceChildren(el("legend", { text: t("plots.quantities") }), ...quantities);
  }

  private choice(testid: string, text: string, checked: boolean, choose: (on: boolean) => void, ...before: Node[]): HTMLElement {
    const box = el("input", { type: "checkbox", testid });
    box.checked = checked;
    box.addEventListener("change", () => choose(box.checked));
    return el("label", { class: "choice" }, box, ...before, text);
  }

  private chooseJoint(name: string, on: boolean): void {
    this.joints = new Set(this.samples.names.filter((other) => (other === name ? on : this.isChosen(other))));
    storePreference("plot-joints", [...this.joints].join());
    this.request(this.context.store.state);
  }

  private chooseQuantity(quantity: Quantity, on: boolean): void {
    if (on) this.quantities.add(quantity);
    else this.quantities.delete(quantity);
    storePreference("plot-quantities", [...this.quantities].join());
    this.request(this.context.store.state);
  }

  /** Save what is shown, with every sample. */
  private saveCsv(): void {
    const [begin_s, end_s] = bounds(this.window, this.extent);
    const stamp = new Date(end_s * 1000).toISOString().replace(/[:.]/g, "-");
    saveFile(`armbridge-${stamp}.csv`, "text/csv", csv(this.samples, this.chosen().flat(), begin_s, end_s));
  }
}

function spanText(span_s: number): string {
  return span_s >= 60 && span_s % 60 === 0 ? `${span_s / 60} min` : `${Number(span_s.toPrecision(3))} s`;
}

function loadChoice(key: string): Set<string> | null {
  const stored = loadPreference(key, "?");
  return stored === "?" ? null : new Set(stored.split(",").filter((name) => name !== ""));
}
