export interface TimeWindow {
  span_s: number;
  /** Its end [s]; null follows the newest sample. */
  end_s: number | null;
}

export interface Extent {
  oldest_s: number;
  newest_s: number;
}

/** Shortest and longest span [s]: a few samples, and as much as is kept. */
export const MIN_SPAN_S = 0.5;
export const MAX_SPAN_S = 600;

export function bounds(window: TimeWindow, { newest_s }: Extent): [number, number] {
  const end_s = window.end_s ?? newest_s;
  return [end_s - window.span_s, end_s];
}

/** Return the window zoomed about a time, which stays in its place; a live window keeps its end, and a factor below 1 shows less. */
export function zoomed(window: TimeWindow, factor: number, about_s: number, extent: Extent): TimeWindow {
  const span_s = Math.min(Math.max(window.span_s * factor, MIN_SPAN_S), MAX_SPAN_S);
  if (window.end_s === null) return { ...window, span_s };
  const share = (window.end_s - about_s) / window.span_s;
  return within({ span_s, end_s: about_s + share * span_s }, extent);
}

/** Return the window moved by a time [s], halted, and not beyond the samples. */
export function panned(window: TimeWindow, by_s: number, extent: Extent): TimeWindow {
  const [, end_s] = bounds(window, extent);
  const moved = within({ ...window, end_s: end_s + by_s }, extent);
  // A window of which little has samples stays: back to where more has would be the other way.
  return by_s < 0 ? { ...moved, end_s: Math.min(moved.end_s ?? end_s, end_s) } : moved;
}

function within({ span_s, end_s }: { span_s: number; end_s: number }, { oldest_s, newest_s }: Extent): TimeWindow {
  // At least a tenth of it has samples.
  const earliest_s = oldest_s + span_s / 10;
  return { span_s, end_s: Math.max(Math.min(end_s, newest_s), Math.min(earliest_s, newest_s)) };
}
