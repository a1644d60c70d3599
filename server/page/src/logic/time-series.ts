/** Samples beyond the capacity, as a share of it, that are kept before the oldest are dropped at once. */
const SPARE = 0.1;

/** Newest samples of several curves over a common time. */
export class TimeSeries {
  /** The times, then each curve; NaN for a missing value. */
  private readonly rows: number[][];

  /**
   * @param curves - number of curves beside the time.
   * @param capacity - number of samples that are kept at least.
   */
  constructor(
    readonly curves: number,
    readonly capacity: number,
  ) {
    this.rows = Array.from({ length: curves + 1 }, () => []);
  }

  /** Times of the samples [s], ascending. */
  get times_s(): readonly number[] {
    return this.rows[0] ?? [];
  }

  /** Add a sample; one that is not later than the last is dropped, as uPlot needs ascending times. */
  push(time_s: number, values: readonly number[]): void {
    if (time_s <= (this.times_s.at(-1) ?? -Infinity)) return;
    this.rows.forEach((row, index) => {
      row.push(index === 0 ? time_s : (values[index - 1] ?? Number.NaN));
      if (row.length > (1 + SPARE) * this.capacity) row.splice(0, row.length - this.capacity);
    });
  }

  clear(): void {
    for (const row of this.rows) row.length = 0;
  }

  /**
   * Return the times of a span, then some of the curves, oldest sample first; gaps are null, as in uPlot.
   *
   * @param curves - indices of the curves, from 0.
   * @param max_points - of more samples, two stand for each of the spans of equal length: the extremes of each curve.
   */
  span(from_s: number, to_s: number, curves: readonly number[], max_points = Infinity): (number | null)[][] {
    const begin = Math.max(0, firstNotBefore(this.times_s, from_s) - 1);
    const end = firstNotBefore(this.times_s, to_s) + 1;
    const [times = [], ...rows] = [0, ...curves.map((curve) => curve + 1)].map((row) => (this.rows[row] ?? []).slice(begin, end));
    const per_bucket = Math.ceil((2 * times.length) / max_points);
    if (per_bucket <= 2) return [times, ...rows.map((row) => row.map(finiteOrNull))];
    const buckets = Array.from({ length: Math.ceil(times.length / per_bucket) }, (_, index) => index * per_bucket);
    // A bucket of one sample at the end has one time twice, which uPlot does not mind.
    const ends = buckets.flatMap((from) => [times[from]!, times[Math.min(from + per_bucket, times.length) - 1]!]);
    return [ends, ...rows.map((row) => buckets.flatMap((from) => extremes(row, from, Math.min(from + per_bucket, row.length))))];
  }
}

/** Return the lowest and the highest value in the order in which they came. */
function extremes(row: readonly number[], begin: number, end: number): (number | null)[] {
  let lowest = begin;
  let highest = begin;
  for (let index = begin; index < end; index += 1) {
    const value = row[index]!;
    if (!(row[lowest]! <= value)) lowest = index;
    if (!(row[highest]! >= value)) highest = index;
  }
  return [row[Math.min(lowest, highest)]!, row[Math.max(lowest, highest)]!].map(finiteOrNull);
}

/** Return the index of the first time that is not before another one; their number without one. */
function firstNotBefore(times_s: readonly number[], time_s: number): number {
  let low = 0;
  let high = times_s.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times_s[middle]! < time_s) low = middle + 1;
    else high = middle;
  }
  return low;
}

function finiteOrNull(value: number): number | null {
  return Number.isFinite(value) ? value : null;
}
