/** Keeps the newest samples of several curves over a common time, in arrays of a fixed size. */
export class Ring {
  private readonly rows: Float64Array[];
  private next = 0;
  private filled = 0;

  /**
   * @param curves - how many curves there are beside the time.
   * @param capacity - how many samples are kept.
   */
  constructor(
    readonly curves: number,
    readonly capacity: number,
  ) {
    this.rows = Array.from({ length: curves + 1 }, () => new Float64Array(capacity));
  }

  /** Add a sample; one that is not later than the last is left out, as time must not run back in a plot. */
  push(time_s: number, values: readonly number[]): void {
    if (this.filled > 0 && !(time_s > this.newest_s)) return;
    this.rows.forEach((row, index) => {
      row[this.next] = index === 0 ? time_s : (values[index - 1] ?? Number.NaN);
    });
    this.next = (this.next + 1) % this.capacity;
    this.filled = Math.min(this.filled + 1, this.capacity);
  }

  /** Forget everything. */
  clear(): void {
    this.next = 0;
    this.filled = 0;
  }

  /** The time of the newest sample [s]; not a number before the first. */
  get newest_s(): number {
    return this.filled === 0 ? Number.NaN : (this.rows[0]?.[(this.next + this.capacity - 1) % this.capacity] ?? Number.NaN);
  }

  /** Time first, then the curves, oldest sample first; gaps, as plots want them, are null. */
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
