import type { ServoState } from "../state/state";
import { RingBuffer } from "./ring-buffer";

/** Time that is kept [s], as the server keeps it; diagnostics come once a second. */
export const HISTORY_S = 600;

/** History of a servo as the server tells it. */
export interface ServoHistory {
  /** Times before now, and so negative [s], oldest first. */
  time_s: number[];
  /** Empty where the servo does not measure it, as is the load. */
  temperature_c: number[];
  load: number[];
  events: string[];
}

/** Curves of a history, after its times. */
export const CURVES = 2;

/** Temperature and load of each servo over the last minutes. */
export class ServoHistories {
  private readonly rings = new Map<string, RingBuffer>();

  /** Add what the servos report at a time [s]; servos that are no longer there are forgotten. */
  record(servos: readonly ServoState[], now_s: number): void {
    for (const name of this.rings.keys()) if (!servos.some((servo) => servo.name === name)) this.rings.delete(name);
    for (const { name, values } of servos) {
      let ring = this.rings.get(name);
      if (!ring) this.rings.set(name, (ring = newRing()));
      ring.push(now_s, [numberOf(values.temperature_c), 100 * numberOf(values.load)]);
    }
  }

  /** Put the server's history, which began before this page, in the place of what has been recorded here. */
  replace(name: string, { time_s, temperature_c, load }: ServoHistory, now_s: number): void {
    const ring = newRing();
    time_s.forEach((time, index) => {
      ring.push(now_s + time, [temperature_c[index] ?? Number.NaN, 100 * (load[index] ?? Number.NaN)]);
    });
    this.rings.set(name, ring);
  }

  /** Return times before now [s], temperatures [°C] and loads [%], oldest first. */
  columns(name: string, now_s: number): (number | null)[][] {
    const [times = [], ...rows] = this.rings.get(name)?.columns() ?? [[], ...Array.from({ length: CURVES }, () => [])];
    return [times.map((time) => (time ?? 0) - now_s), ...rows];
  }
}

function newRing(): RingBuffer {
  return new RingBuffer(CURVES, HISTORY_S);
}

function numberOf(text: string | undefined): number {
  return text === undefined || text === "" ? Number.NaN : Number(text);
}
