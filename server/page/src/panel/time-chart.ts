import "uplot/dist/uPlot.min.css";
import uPlot from "uplot";

export interface TimeCurve {
  label: string;
  /** Name of the custom property with its colour, as "--measured". */
  color: string;
  dashed?: boolean;
  digits: number;
}

/** Chart of one unit among several over the same times. */
export interface TimeChartOptions {
  title: string;
  unit: string;
  curves: TimeCurve[];
  /** Least range of the values, so that noise does not fill the chart. */
  least_range: number;
  /** Zoom by a factor about a time; move by a time [s]; a chart without them stands still. */
  zoom?: (factor: number, about_s: number) => void;
  pan?: (by_s: number) => void;
}

/** Least size of a chart; a hidden one has none [px]. */
const MIN_SIZE_PX = 50;

const WHEEL_ZOOM = 0.2;

const SYNC_KEY = "plots";

/** Chart that is zoomed by wheel and pinch, moved by dragging, and tells the values at the cursor. */
export class TimeChart {
  readonly element: HTMLElement;
  private readonly plot: uPlot;
  private readonly host: HTMLElement;
  private readonly values: HTMLElement;
  private range: [number, number] = [-1, 0];

  constructor(private readonly options: TimeChartOptions) {
    this.host = create("div", "plot");
    this.values = create("p", "plot-values", "hint");
    const title = create("figcaption");
    title.textContent = `${options.title} [${options.unit}]`;
    this.element = create("figure", "time-chart");
    this.element.append(title, this.host, this.values);
    this.plot = this.createPlot();
    if (options.zoom && options.pan) this.listen(this.plot.over, options.zoom, options.pan);
  }

  /** Draw the times, relative to the shown zero, then each curve. */
  draw(rows: (number | null)[][], range: [number, number]): void {
    this.range = range;
    const width = Math.max(this.host.clientWidth, MIN_SIZE_PX);
    const height = Math.max(this.host.clientHeight, MIN_SIZE_PX);
    if (width !== this.plot.width || height !== this.plot.height) this.plot.setSize({ width, height });
    this.plot.setData(rows as uPlot.AlignedData);
    this.showValues();
  }

  setCursor(share: number): void {
    const { clientWidth: width, clientHeight: height } = this.plot.over;
    this.plot.setCursor({ left: share * width, top: height / 2 });
  }

  destroy(): void {
    this.plot.destroy();
    this.element.remove();
  }

  private createPlot(): uPlot {
    const { curves, least_range } = this.options;
    const color = colorsOf(this.host);
    const axis = axisOf(color);
    const series = curves.map(({ label, color: name, dashed }): uPlot.Series => {
      return { label, stroke: color(name), width: 1.5, spanGaps: false, points: { show: false }, ...(dashed && { dash: [6, 4] }) };
    });
    return new uPlot(
      {
        width: MIN_SIZE_PX,
        height: MIN_SIZE_PX,
        legend: { show: false },
        cursor: { sync: { key: SYNC_KEY }, drag: { x: false, y: false, setScale: false }, points: { show: false }, y: false },
        scales: {
          x: { time: false, range: () => this.range },
          y: { range: (_, lowest, highest) => widened(lowest, highest, least_range) },
        },
        axes: [axis, { ...axis, size: 48 }],
        series: [{ label: "s" }, ...series],
        hooks: { setCursor: [() => this.showValues()] },
      },
      [[], ...curves.map(() => [])] as uPlot.AlignedData,
      this.host,
    );
  }

  private showValues(): void {
    // The hook runs once before the constructor has the plot.
    const index = this.plot?.cursor.idx;
    const time_s = index === null || index === undefined ? undefined : this.plot.data[0]?.[index];
    if (time_s === undefined) return void (this.values.textContent = "");
    const texts = this.options.curves.map(({ label, digits }, curve) => {
      const value = this.plot.data[curve + 1]?.[index as number];
      return `${label} ${typeof value === "number" ? value.toFixed(digits) : "–"}`;
    });
    this.values.textContent = `${time_s.toFixed(2)} s: ${texts.join(", ")}`;
  }

  /** Wheel zooms, one pointer drags, two pinch. */
  private listen(over: HTMLElement, zoom: (factor: number, about_s: number) => void, pan: (by_s: number) => void): void {
    const pointers = new Map<number, number>();
    const timeAt = (x_px: number): number => {
      const { left, width } = over.getBoundingClientRect();
      return this.range[0] + ((x_px - left) / width) * (this.range[1] - this.range[0]);
    };
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom((1 + WHEEL_ZOOM) ** (event.deltaY / 100), timeAt(event.clientX));
    });
    over.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, event.clientX);
      over.setPointerCapture(event.pointerId);
    });
    over.addEventListener("pointermove", (event) => {
      const before_px = pointers.get(event.pointerId);
      if (before_px === undefined || before_px === event.clientX) return;
      const other_px = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      if (other_px === undefined) pan(timeAt(before_px) - timeAt(event.clientX));
      else if (event.clientX !== other_px) {
        const factor = Math.abs((before_px - other_px) / (event.clientX - other_px));
        zoom(factor, timeAt(other_px));
      }
      pointers.set(event.pointerId, event.clientX);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      over.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }
  }
}

function create(tag: string, ...kinds: string[]): HTMLElement {
  const element = document.createElement(tag);
  element.classList.add(...kinds);
  return element;
}

/** Return a function that gives a custom property's present colour, which theme and system change. */
function colorsOf(host: HTMLElement): (name: string) => () => string {
  // The computed colour, as the custom property itself is a light-dark() pair.
  const probe = host.appendChild(create("i"));
  probe.hidden = true;
  return (name) => () => {
    probe.style.color = `var(${name})`;
    return getComputedStyle(probe).color;
  };
}

function axisOf(color: (name: string) => () => string): uPlot.Axis {
  return { stroke: color("--dim"), grid: { stroke: color("--line"), width: 1 }, ticks: { show: false } };
}

/** Return a range of the values with some space around them, and not less than the least. */
function widened(lowest: number | null, highest: number | null, least: number): [number, number] {
  const low = lowest ?? 0;
  const high = highest ?? 0;
  const middle = (low + high) / 2;
  const half = Math.max((high - low) * 0.55, least / 2);
  return [middle - half, middle + half];
}
