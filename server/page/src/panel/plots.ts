import "uplot/dist/uPlot.min.css";
import uPlot from "uplot";
import { armJoints, currentPositions, jointKind } from "../logic/joints";
import { toUnit, unitOf, type Unit } from "../logic/numbers";
import type { State } from "../state/state";
import type { PanelContext } from "./context";
import { el, section, throttle } from "./dom";

/** Ring buffer of the newest samples of several curves over a common time. */
export class RingBuffer {
  private readonly rows: Float64Array[];
  private next = 0;
  private filled = 0;

  /**
   * @param curves - number of curves beside the time.
   * @param capacity - number of samples that are kept.
   */
  constructor(
    readonly curves: number,
    readonly capacity: number,
  ) {
    this.rows = Array.from({ length: curves + 1 }, () => new Float64Array(capacity));
  }

  /** Add a sample; one that is not later than the last is dropped, as uPlot needs ascending times. */
  push(time_s: number, values: readonly number[]): void {
    if (this.filled > 0 && !(time_s > this.newest_s)) return;
    this.rows.forEach((row, index) => {
      row[this.next] = index === 0 ? time_s : (values[index - 1] ?? Number.NaN);
    });
    this.next = (this.next + 1) % this.capacity;
    this.filled = Math.min(this.filled + 1, this.capacity);
  }

  /** Remove all samples. */
  clear(): void {
    this.next = 0;
    this.filled = 0;
  }

  /** Time of the newest sample [s]; NaN before the first. */
  get newest_s(): number {
    const newest = (this.next + this.capacity - 1) % this.capacity;
    return this.filled === 0 ? Number.NaN : (this.rows[0]?.[newest] ?? Number.NaN);
  }

  /** Return the times, then each curve, oldest sample first; gaps are null, as in uPlot. */
  columns(): (number | null)[][] {
    const begin = (this.next + this.capacity - this.filled) % this.capacity;
    return this.rows.map((row) => {
      return Array.from({ length: this.filled }, (_, index) => {
        const value = row[(begin + index) % this.capacity] ?? Number.NaN;
        return Number.isFinite(value) ? value : null;
      });
    });
  }
}

/** Time that is shown [s], and the samples of it at 30 messages per second. */
const WINDOW_S = 20;
const SAMPLES = 30 * WINDOW_S;

/** Time between two drawings [ms]: each takes a few milliseconds, and this rate looks live. */
const REDRAW_PERIOD_MS = 150;

const HEIGHT_PX = 150;

/** Create the plot of a joint's commanded and measured position. */
export function plotsSection({ store }: PanelContext): HTMLElement {
  const choice = el("select", { testid: "plot-joint", label: "joint of the plot" });
  const host = el("div", { class: "plot", testid: "plot" });
  const line = el("label", { class: "line" }, "Joint ", choice);
  const box = section("plots", "Plot: commanded and measured", true, line, host);
  const rings = new Map<string, RingBuffer>();
  let chart: uPlot | null = null;
  const unit = (state: State): Unit => unitOf(jointKind(state, choice.value), state.settings.units);
  const draw = throttle<State>(REDRAW_PERIOD_MS, (state) => {
    if (!box.open || !host.isConnected) return;
    updateChoices(choice, armJoints(state));
    chart ??= createChart(host, () => unit(store.state).suffix);
    chart.setSize({ width: Math.max(host.clientWidth, 50), height: HEIGHT_PX });
    chart.setData(plotData(rings.get(choice.value), unit(state)));
  });
  store.subscribe(
    (state) => state.joints,
    (_, state) => {
      recordSample(rings, state);
      draw(state);
    },
  );
  store.subscribe((state) => state.settings.units, (_, state) => draw(state));
  box.addEventListener("toggle", () => draw(store.state));
  choice.addEventListener("change", () => draw(store.state));
  return box;
}

/** Step back in time [s] that means a restarted server, with another clock. */
const CLOCK_RESET_S = 1;

function recordSample(rings: Map<string, RingBuffer>, state: State): void {
  const measured = currentPositions(state);
  for (const name of armJoints(state)) {
    let ring = rings.get(name);
    if (!ring) rings.set(name, (ring = new RingBuffer(2, SAMPLES)));
    if (state.joints.stamp < ring.newest_s - CLOCK_RESET_S) ring.clear();
    ring.push(state.joints.stamp, [state.commanded_rad[name] ?? Number.NaN, measured[name] ?? Number.NaN]);
  }
}

function plotData(ring: RingBuffer | undefined, unit: Unit): uPlot.AlignedData {
  const [times = [], ...rows] = ring?.columns() ?? [[], [], []];
  const newest_s = ring?.newest_s ?? 0;
  const shown = rows.map((row) => row.map((value) => (value === null ? null : toUnit(value, unit))));
  return [times.map((time_s) => (time_s ?? 0) - newest_s), ...shown] as uPlot.AlignedData;
}

function createChart(host: HTMLElement, unit: () => string): uPlot {
  // The computed colour, as the custom property itself is a light-dark() pair.
  const probe = host.appendChild(el("i", { attributes: { hidden: "" } }));
  const color = (name: string) => (): string => {
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  };
  const axis: uPlot.Axis = {
    stroke: color("--dim"),
    grid: { stroke: color("--line"), width: 1 },
    ticks: { show: false },
  };
  const value = (_: uPlot, raw: number | null): string => (raw === null ? "–" : `${raw.toFixed(2)}${unit()}`);
  const options: uPlot.Options = {
    width: Math.max(host.clientWidth, 50),
    height: HEIGHT_PX,
    cursor: { show: false },
    legend: { live: false },
    scales: { x: { time: false, range: [-WINDOW_S, 0] } },
    axes: [axis, { ...axis, size: 48 }],
    series: [
      { label: "s" },
      { label: "commanded", stroke: color("--commanded"), dash: [6, 4], width: 2, value },
      { label: "measured", stroke: color("--measured"), width: 1.5, value },
    ],
  };
  return new uPlot(options, [[], [], []], host);
}

function updateChoices(choice: HTMLSelectElement, names: string[]): void {
  if (names.join() === [...choice.options].map(({ value }) => value).join()) return;
  const before = choice.value;
  choice.replaceChildren(...names.map((name) => el("option", { text: name, attributes: { value: name } })));
  if (names.includes(before)) choice.value = before;
}
