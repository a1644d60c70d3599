import type { Cell, Point, Slice } from "../state/state";
import { childrenOf, readXml } from "./xml";

/** Squares along the edge of a slice, from coarse to fine: each pass halves those that the one before has left. */
const PASSES = [8, 16, 32];

/** Point to check, with the edge of the square that shows its answer. */
export type RegionPoint = Pick<Cell, "point_m" | "edge_m">;

/** Return an upper bound of a robot's reach from its root link [m]: the longest way along its joints; 0 without joints. */
export function reach_m(urdf: string | null): number {
  const robot = readXml(urdf ?? "");
  const above = new Map<string, { parent: string; length_m: number }>();
  for (const joint of childrenOf(robot, "joint")) {
    const link = (end: string): string => childrenOf(joint, end)[0]?.attributes.link ?? "";
    const place = childrenOf(joint, "origin")[0]?.attributes.xyz?.trim().split(/\s+/).map(Number) ?? [];
    const limit = childrenOf(joint, "limit")[0]?.attributes ?? {};
    const slide_m = joint.attributes.type === "prismatic" ? Math.max(Math.abs(Number(limit.lower)), Math.abs(Number(limit.upper))) : 0;
    const length_m = Math.hypot(...place) + slide_m;
    above.set(link("child"), { parent: link("parent"), length_m: Number.isFinite(length_m) ? length_m : 0 });
  }
  const lengths = [...above.keys()].map((link) => {
    let sum_m = 0;
    // No longer than there are joints, so that a loop ends too.
    for (let [at, steps] = [above.get(link), 0]; at !== undefined && steps <= above.size; at = above.get(at.parent), steps += 1) {
      sum_m += at.length_m;
    }
    return sum_m;
  });
  return Math.max(0, ...lengths);
}

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
