import "uplot/dist/uPlot.min.css";
import uPlot from "uplot";
import { el } from "./dom";

/** Curve of a chart. */
export interface Curve {
  label: string;
  /** Name of the custom property with its colour, as "--measured". */
  color: string;
  /** Drawn dashed. */
  dashed?: boolean;
}

/** Options of a chart. */
export interface ChartOptions {
  /** Time that is shown, up to now, in its unit. */
  window: number;
  time_unit: "s" | "min";
  height_px: number;
  curves: Curve[];
  /** Least range of the values, so that noise does not fill the chart; without one the range is that of the data. */
  least_range?: [number, number];
}

/** Least width of a chart; a hidden one has none [px]. */
const MIN_WIDTH_PX = 50;

/** Chart of curves over the last seconds. */
export class Chart {
  private readonly plot: uPlot;

  /** @param host - element to draw in. */
  constructor(
    private readonly host: HTMLElement,
    private readonly options: ChartOptions,
  ) {
    this.plot = createPlot(host, options);
  }

  /** Draw rows as of RingBuffer.columns(): times before now, in their unit, then each curve. */
  draw(rows: (number | null)[][]): void {
    this.plot.setSize({ width: Math.max(this.host.clientWidth, MIN_WIDTH_PX), height: this.options.height_px });
    this.plot.setData(rows as uPlot.AlignedData);
  }
}

function createPlot(host: HTMLElement, { window, time_unit, height_px, curves, least_range }: ChartOptions): uPlot {
  const color = colorsOf(host);
  const axis = axisOf(color);
  const series = curves.map(({ label, color: name, dashed }): uPlot.Series => {
    return { label, stroke: color(name), ...(dashed ? { dash: [6, 4], width: 2 } : { width: 1.5 }) };
  });
  const [least, most] = least_range ?? [0, 0];
  // Without data uPlot gives null.
  const y: uPlot.Scale = { range: (_, lowest, highest) => [Math.min(least, lowest ?? least), Math.max(most, highest ?? most)] };
  const options: uPlot.Options = {
    width: Math.max(host.clientWidth, MIN_WIDTH_PX),
    height: height_px,
    cursor: { show: false },
    legend: { live: false },
    scales: { x: { time: false, range: [-window, 0] }, ...(least_range && { y }) },
    axes: [axis, { ...axis, size: 48 }],
    series: [{ label: time_unit }, ...series],
  };
  return new uPlot(options, [[], ...curves.map(() => [])] as uPlot.AlignedData, host);
}

/** Return a function that gives a custom property's present colour, which theme and system change. */
export function colorsOf(host: HTMLElement): (name: string) => () => string {
  // The computed colour, as the custom property itself is a light-dark() pair.
  const probe = host.appendChild(el("i", { attributes: { hidden: "" } }));
  return (name) => () => {
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  };
}

/** Return the look of an axis. */
export function axisOf(color: (name: string) => () => string): uPlot.Axis {
  return { stroke: color("--dim"), grid: { stroke: color("--line"), width: 1 }, ticks: { show: false } };
}
