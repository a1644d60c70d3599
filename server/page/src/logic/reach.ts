import type { Point } from "../state/state";

export interface ReachOutline {
  center: [number, number];
  /** Greatest distance from the center in each sector, counterclockwise from x; 0 where the tool does not get [m]. */
  radius_m: number[];
}

// Sectors of 5 degrees; a share of the samples is spent on making the farthest of each sector better.
export const SECTORS = 72;
const RANDOM_SAMPLES = 1200;
const ROUNDS = 8;
const STEP = 0.12;

/** Return a repeatable source of numbers from 0 to 1 (Park and Miller, 1988), so that the outline does not jump. */
function repeatableRandom(): () => number {
  let seed = 1;
  return () => {
    seed = (seed * 48271) % 2147483647;
    return seed / 2147483647;
  };
}

/** Return the outline of the tool's reach from above, from samples of the forward kinematics for shares of the joints' ranges. */
export function reachOutline(
  tool: (shares: readonly number[]) => Point,
  joint_count: number,
  center: [number, number],
): ReachOutline {
  const radius_m = new Array<number>(SECTORS).fill(0);
  const best = new Array<number[] | null>(SECTORS).fill(null);
  const random = repeatableRandom();
  const attempt = (shares: number[]): void => {
    const [x, y] = tool(shares);
    const [from_x, from_y] = [x - center[0], y - center[1]];
    const turn = Math.atan2(from_y, from_x) / (2 * Math.PI);
    const sector = Math.floor((turn + 1) * SECTORS) % SECTORS;
    const distance_m = Math.hypot(from_x, from_y);
    if (!(distance_m > (radius_m[sector] ?? 0))) return;
    radius_m[sector] = distance_m;
    best[sector] = shares;
  };
  for (let count = 0; count < RANDOM_SAMPLES; count += 1) attempt(Array.from({ length: joint_count }, random));
  for (let round = 0; round < ROUNDS; round += 1) {
    const step = STEP / (round + 1);
    for (const shares of [...best]) {
      if (shares === null) continue;
      attempt(shares.map((share) => Math.min(1, Math.max(0, share + step * (2 * random() - 1)))));
    }
  }
  return { center, radius_m: smoothed(radius_m) };
}

/** Return the mean over the neighbours that are reached, as samples leave the outline ragged. */
function smoothed(radius_m: number[]): number[] {
  return radius_m.map((own, index) => {
    if (own === 0) return 0;
    const around = [-2, -1, 0, 1, 2].map((step) => radius_m[(index + step + SECTORS) % SECTORS] ?? 0);
    const reached = around.filter((value) => value > 0);
    return reached.reduce((sum, value) => sum + value, 0) / reached.length;
  });
}
