import type { ArmHealth } from "../state/state";
import type { TextKey } from "../texts/texts";

export interface HealthRow {
  /** Short name, which also chooses its title. */
  id: "latency" | "loop" | "machine" | "bus" | "answers";
  texts: [TextKey, Record<string, string | number>][];
  warn: boolean;
}

/** Round trip that driving by hand feels [ms]. */
const SLOW_ROUND_TRIP_MS = 50;

/** Lateness of the control loop, of a period of 10 ms, from which motions may jerk [ms]. */
const LATE_MS = 10;

/** Share of lost answers for which cables deserve a look, and how few are never a reason; as the server has them. */
const LOST_SHARE = 0.01;
const FEW_LOST = 20;

/** Real-time factor below which a simulation is slow, as the server has it. */
const SLOW_FACTOR = 0.9;

export function healthRows({ values }: ArmHealth, latency_ms: number | null): HealthRow[] {
  const rows = [latencyRow(latency_ms), loopRow(values), machineRow(values), busRow(values), answersRow(values)];
  return rows.filter((row) => row !== null);
}

type Values = Record<string, string>;

function latencyRow(latency_ms: number | null): HealthRow {
  if (latency_ms === null) return { id: "latency", texts: [["health.latency.none", {}]], warn: false };
  const warn = latency_ms > SLOW_ROUND_TRIP_MS;
  const key = warn ? "health.latency.slow" : "health.latency.good";
  return { id: "latency", texts: [[key, { ms: latency_ms.toFixed(latency_ms < 10 ? 1 : 0) }]], warn };
}

function loopRow(values: Values): HealthRow | null {
  const lateness = percentiles(values.loop_lateness_ms);
  if (lateness === null) return null;
  const warn = lateness.p99 > LATE_MS;
  const key = warn ? "health.loop.late" : "health.loop.text";
  return { id: "loop", texts: [[key, shown(lateness)]], warn };
}

function machineRow(values: Values): HealthRow | null {
  if (values.real_time_priority === undefined) return null;
  const factor = Number(values.real_time_factor ?? 1);
  const warn = factor < SLOW_FACTOR;
  const key = values.real_time_priority === "true" ? "health.machine.real_time" : "health.machine.no_real_time";
  const slow: HealthRow["texts"] = warn ? [["health.machine.slow", { share: Math.round(100 * factor) }]] : [];
  return { id: "machine", texts: [[key, {}], ...slow], warn };
}

function busRow(values: Values): HealthRow | null {
  const port = values.port;
  if (port === undefined) return null;
  const round_trip = percentiles(values.bus_round_trip_ms);
  // A simulated arm answers at once, or counts no messages at all.
  const simulated = values.bus_sent === undefined || round_trip?.max === 0;
  if (simulated) return { id: "bus", texts: [["health.bus.simulated", {}]], warn: false };
  const text: HealthRow["texts"][0] = round_trip ? ["health.bus.text", { port, ...shown(round_trip) }] : ["health.bus.port", { port }];
  return { id: "bus", texts: [text], warn: false };
}

function answersRow(values: Values): HealthRow | null {
  const [sent, lost, retries, bytes] = ["bus_sent", "bus_timeouts", "bus_retries", "bus_discarded_bytes"].map((key) => Number(values[key] ?? 0));
  if (!sent || lost === undefined) return null;
  const warn = lost > Math.max(FEW_LOST, LOST_SHARE * sent);
  const texts: HealthRow["texts"] = [[lost === 0 ? "health.answers.good" : warn ? "health.answers.lost" : "health.answers.few", { sent, lost }]];
  if (retries) texts.push(["health.answers.retries", { retries }]);
  if (bytes) texts.push(["health.answers.garbled", { bytes }]);
  return { id: "answers", texts, warn };
}

interface Percentiles {
  p50: number;
  p99: number;
  max: number;
}

/** Read "p50 0.1, p99 0.2, max 0.3"; null for another text. */
function percentiles(text: string | undefined): Percentiles | null {
  const [p50, p99, max] = (/^p50 ([\d.]+), p99 ([\d.]+), max ([\d.]+)$/.exec(text ?? "") ?? []).slice(1).map(Number);
  return p50 === undefined || p99 === undefined || max === undefined ? null : { p50, p99, max };
}

function shown({ p50, max }: Percentiles): { typical: string; greatest: string } {
  return { typical: p50.toFixed(2), greatest: max.toFixed(1) };
}
