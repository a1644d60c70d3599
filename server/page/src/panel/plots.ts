import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { armJoints, present } from "../logic/joint-names";
import { Ring } from "../logic/ring";
import { toUnit, unitSign } from "../logic/units";
import { paced } from "../state/pace";
import type { State } from "../state/state";
import { el, section } from "./dom";
import type { Page } from "./page";

/** What is shown of the past [s], and what is kept for it at 30 messages a second. */
const WINDOW_S = 20;
const SAMPLES = 30 * WINDOW_S;

/** Drawing costs a few milliseconds; so often looks live [ms]. */
const REDRAWN_MS = 150;

const HEIGHT_PX = 150;

/** One joint over time: where it was wanted, and where it was. */
export function plots({ store }: Page): HTMLElement {
  const choice = el("select", { testid: "plot-joint", label: "joint of the plot" });
  const host = el("div", { class: "plot", testid: "plot" });
  const box = section("plots", "Plot: commanded and measured", true, el("label", { class: "line" }, "Joint ", choice), host);
  const rings = new Map<string, Ring>();
  let chart: uPlot | null = null;
  const draw = paced<State>(REDRAWN_MS, (state) => {
    if (!box.open || !host.isConnected) return;
    offer(choice, armJoints(state));
    chart ??= newChart(host, () => unitSign(store.state.settings.units));
    chart.setSize({ width: Math.max(host.clientWidth, 50), height: HEIGHT_PX });
    chart.setData(curves(rings.get(choice.value), state));
  });
  store.subscribe(
    (state) => state.joints,
    (_, state) => {
      sample(rings, state);
      draw(state);
    },
  );
  store.subscribe((state) => state.settings.units, (_, state) => draw(state));
  box.addEventListener("toggle", () => draw(store.state));
  choice.addEventListener("change", () => draw(store.state));
  return box;
}

/** A stamp so far back is of a server that was started anew, with another clock [s]. */
const JUMP_S = 1;

function sample(rings: Map<string, Ring>, state: State): void {
  const measured = present(state);
  for (const name of armJoints(state)) {
    let ring = rings.get(name);
    if (!ring) rings.set(name, (ring = new Ring(2, SAMPLES)));
    if (state.joints.stamp < ring.newest_s - JUMP_S) ring.clear();
    ring.push(state.joints.stamp, [state.commanded_rad[name] ?? Number.NaN, measured[name] ?? Number.NaN]);
  }
}

function curves(ring: Ring | undefined, state: State): uPlot.AlignedData {
  const [times = [], ...rows] = ring?.columns() ?? [[], [], []];
  const newest_s = ring?.newest_s ?? 0;
  const shown = rows.map((row) => row.map((value) => (value === null ? null : toUnit(value, state.settings.units))));
  return [times.map((time_s) => (time_s ?? 0) - newest_s), ...shown] as uPlot.AlignedData;
}

function newChart(host: HTMLElement, unit: () => string): uPlot {
  // The computed colour: a property's own text may still hold both, for light and for dark.
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

function offer(choice: HTMLSelectElement, names: string[]): void {
  if (names.join() === [...choice.options].map(({ value }) => value).join()) return;
  const before = choice.value;
  choice.replaceChildren(...names.map((name) => el("option", { text: name, attributes: { value: name } })));
  if (names.includes(before)) choice.value = before;
}
