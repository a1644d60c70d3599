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

  /** Number of samples. */
  get count(): number {
    return this.filled;
  }

  /** Time of the oldest sample [s]; NaN before the first. */
  get oldest_s(): number {
    return this.filled === 0 ? Number.NaN : this.at(0, 0);
  }

  /**
   * Return the times of a span, then some of the curves, oldest sample first; gaps are null, as in uPlot.
   *
   * @param curves - indices of the curves, from 0.
   * @param max_points - of more samples, two stand for each of the spans of equal length: the extremes of each curve.
   */
  span(from_s: number, to_s: number, curves: readonly number[], max_points = Infinity): (number | null)[][] {
    const begin = Math.max(0, this.firstNotBefore(from_s) - 1);
    const end = Math.min(this.filled, this.firstNotBefore(to_s) + 1);
    const per_bucket = Math.ceil((2 * (end - begin)) / max_points);
    if (per_bucket <= 2) return [0, ...curves.map((curve) => curve + 1)].map((row) => this.copy(row, begin, end));
    const times: number[] = [];
    const rows = curves.map((): (number | null)[] => []);
    for (let from = begin; from < end; from += per_bucket) {
      const to = Math.min(from + per_bucket, end);
      times.push(this.at(0, from), this.at(0, to - 1));
      curves.forEach((curve, index) => rows[index]?.push(...this.extremes(curve + 1, from, to)));
    }
    // A bucket of one sample at the end has one time twice, which uPlot does not mind.
    return [times, ...rows];
  }

  private at(row: number, index: number): number {
    const begin = (this.next + this.capacity - this.filled) % this.capacity;
    return this.rows[row]?.[(begin + index) % this.capacity] ?? Number.NaN;
  }

  private copy(row: number, begin: number, end: number): (number | null)[] {
    return Array.from({ length: Math.max(0, end - begin) }, (_, index) => finiteOrNull(this.at(row, begin + index)));
  }

  /** Return the lowest and the highest value in the order in which they came. */
  private extremes(row: number, begin: number, end: number): [number | null, number | null] {
    let lowest = begin;
    let highest = begin;
    for (let index = begin; index < end; index += 1) {
      const value = this.at(row, index);
      if (!(this.at(row, lowest) <= value)) lowest = index;
      if (!(this.at(row, highest) >= value)) highest = index;
    }
    const first = this.at(row, Math.min(lowest, highest));
    return [finiteOrNull(first), finiteOrNull(this.at(row, Math.max(lowest, highest)))];
  }

  /** Return the index of the first sample at a time or later, counted from the oldest; `filled` without one. */
  private firstNotBefore(time_s: number): number {
    let low = 0;
    let high = this.filled;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(0, middle) < time_s) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

function finiteOrNull(value: number): number | null {
  return Number.isFinite(value) ? value : null;
}
