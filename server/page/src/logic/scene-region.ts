import type { Cell, Point, Slice } from "../state/state";

/** Squares along the edge of a slice, from coarse to fine: each pass halves those that the one before has left. */
const PASSES = [8, 16, 32];

/** Point to check, with the edge of the square that shows its answer. */
export type RegionPoint = Pick<Cell, "point_m" | "edge_m">;

/** Return the points of a slice that are checked, the coarse ones first, so that the whole is seen soon. */
export function regionPoints(slice: Slice, radius_m: number): RegionPoint[] {
  const finest = PASSES.at(-1) ?? 1;
  const edge_m = (2 * radius_m) / finest;
  const seen = new Set<string>();
  return PASSES.flatMap((count) => {
    const step = finest / count;
    const points: RegionPoint[] = [];
    for (let row = 0; row < finest; row += step) {
      for (let column = 0; column < finest; column += step) {
        const key = `${row} ${column}`;
        const u = -radius_m + (column + 0.5) * edge_m;
        const v = -radius_m + (row + 0.5) * edge_m;
        if (seen.has(key) || Math.hypot(u, v) > radius_m) continue;
        seen.add(key);
        points.push({ point_m: inSpace(slice, u, v), edge_m });
      }
    }
    return points;
  });
}

/** Return the point of a slice: u goes outward, v upward or to the left. */
function inSpace({ kind, height_m, angle_rad }: Slice, u: number, v: number): Point {
  if (kind === "level") return [u, v, height_m];
  return [u * Math.cos(angle_rad), u * Math.sin(angle_rad), v];
}

/**
 * Return the reach that an answer of the server tells; distances within the tolerance count as reached.
 *
 * @param was_free - true where the tip could be in an earlier scene: a search among objects often ends without having
 *   found the configuration that something is in the way of.
 */
export function reachOf(
  check: { reachable: boolean; free: boolean; position_error_m: number },
  tolerance_m: number,
  was_free: boolean,
): Cell["reach"] {
  const reached = check.reachable && check.position_error_m <= tolerance_m;
  if (reached && check.free) return "free";
  return reached || was_free ? "contact" : "out";
}
