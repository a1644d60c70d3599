/** Seconds between two attempts to connect: the first, and the most. */
const FIRST_S = 0.25;
const MOST_S = 2;

/**
 * How long to wait before the next attempt to connect [s].
 *
 * @param failures - attempts that have failed since the link was last up, at least 1.
 */
export function backoff_s(failures: number): number {
  return Math.min(MOST_S, FIRST_S * 2 ** Math.max(0, failures - 1));
}
