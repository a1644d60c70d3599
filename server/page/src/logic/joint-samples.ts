import type { JointValues, State } from "../state/state";
import { jointKind } from "./joints";
import { unitOf } from "./numbers";
import { TimeSeries } from "./time-series";
import { MAX_SPAN_S } from "./time-window";

/** Quantities of a joint that are recorded, in the order of its curves. */
export const QUANTITIES = ["position", "goal", "error", "velocity", "load", "temperature"] as const;
export type Quantity = (typeof QUANTITIES)[number];

/** Samples that are kept at 30 messages per second. */
const MAX_SAMPLES = 30 * MAX_SPAN_S;

/** Numbers that are kept at most, of 8 bytes each: robots with many joints have a shorter past. */
const MAX_NUMBERS = 2_000_000;

/** Step back in time [s] that means a restarted server, with another clock. */
const CLOCK_RESET_S = 1;

type SampledState = Pick<State, "joints" | "commanded_rad" | "servos">;

/** Newest minutes of every quantity of every joint, at common times. */
export class JointSamples {
  names: readonly string[] = [];
  series = new TimeSeries(0, 1);

  /** Add the newest state of the joints; other joints, or another clock, begin anew. */
  record(state: SampledState): void {
    const { names, stamp } = state.joints;
    if (names.length === 0) return;
    if (names.join() !== this.names.join()) {
      this.names = [...names];
      const curves = names.length * QUANTITIES.length;
      this.series = new TimeSeries(curves, Math.min(MAX_SAMPLES, Math.floor(MAX_NUMBERS / (curves + 1))));
    }
    if (stamp < (this.series.times_s.at(-1) ?? 0) - CLOCK_RESET_S) this.series.clear();
    this.series.push(stamp, sampleValues(state));
  }

  /** Return the index of a curve; -1 for a joint that there is not. */
  curve(joint: string, quantity: Quantity): number {
    const index = this.names.indexOf(joint);
    return index < 0 ? -1 : index * QUANTITIES.length + QUANTITIES.indexOf(quantity);
  }
}

function sampleValues({ joints, commanded_rad, servos }: SampledState): number[] {
  const temperatures: JointValues = {};
  for (const { name, values } of servos) temperatures[name] = Number(values.temperature_c || Number.NaN);
  return joints.names.flatMap((name, index) => {
    const position = joints.position_rad[index] ?? Number.NaN;
    const goal = commanded_rad[name] ?? Number.NaN;
    const velocity = joints.velocity[index] ?? Number.NaN;
      return [position, goal, goal - position, velocity, joints.effort[index] ?? Number.NaN, temperatures[name] ?? Number.NaN];
  });
}

/** Unit of a curve: its name in files and charts, and units per radian, metre or share. */
export interface CurveUnit {
  name: string;
  scale: number;
  digits: number;
}

export function curveUnit(state: Pick<State, "robot" | "settings">, joint: string, quantity: Quantity): CurveUnit {
  if (quantity === "load") return { name: "%", scale: 100, digits: 0 };
  if (quantity === "temperature") return { name: "°C", scale: 1, digits: 0 };
  const unit = unitOf(jointKind(state, joint), state.settings.units);
  const name = unit.suffix.trim();
  const digits = quantity === "error" ? unit.digits + 1 : unit.digits;
  return { name: quantity === "velocity" ? `${name}/s` : name, scale: unit.scale, digits };
}

export interface Column {
  joint: string;
  quantity: Quantity;
  unit: CurveUnit;
}

/** Return a span of the samples as CSV (RFC 4180): a column for each curve with its unit, times in seconds from the first. */
export function csv(samples: JointSamples, columns: readonly Column[], from_s: number, to_s: number): string {
  const curves = columns.map(({ joint, quantity }) => samples.curve(joint, quantity));
  const [times = [], ...rows] = samples.series.span(from_s, to_s, curves);
  const inside = times.flatMap((time_s, index) => (time_s !== null && time_s >= from_s && time_s <= to_s ? [index] : []));
  const first_s = times[inside[0] ?? 0] ?? 0;
  const head = ["time [s]", ...columns.map(({ joint, quantity, unit }) => `${joint} ${quantity} [${unit.name}]`)];
  const lines = inside.map((index) => {
    const values = rows.map((row, column) => {
      const value = row[index] ?? null;
      return value === null ? "" : String(Number((value * (columns[column]?.unit.scale ?? 1)).toPrecision(7)));
    });
    return [((times[index] ?? 0) - first_s).toFixed(4), ...values].join(",");
  });
  return `${[head.map(quoted).join(","), ...lines].join("\r\n")}\r\n`;
}

function quoted(text: string): string {
  return /[",\r\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
}
