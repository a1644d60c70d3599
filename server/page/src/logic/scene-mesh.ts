import type { Point, Shape } from "../state/state";
import { t } from "../texts/texts";

/** Largest mesh file that is read [bytes]: beyond it a browser is busy for seconds, and a phone fails. */
export const MAX_FILE_BYTES = 30_000_000;

/** Most triangles that the server takes of a mesh (planners/scene_checks.py). */
export const MAX_TRIANGLES = 80_000;

export const MESH_KINDS = ["stl", "obj", "dae"] as const;

export const FILE_UNITS: Record<string, number> = { mm: 0.001, cm: 0.01, m: 1, in: 0.0254 };

export interface MadeMesh {
  vertices: Point[];
  triangles: Shape["triangles"];
  /** Greatest distance that a corner was moved for having fewer triangles [m]; 0 where none was. */
  deviation_m: number;
}

/** Reason why a file is not read, with its values for a sentence; null when it can be. */
export function fileProblem(name: string, size_bytes: number): { key: "kind" | "large"; values: Record<string, string> } | null {
  const kind = fileKind(name);
  if (!MESH_KINDS.some((known) => known === kind)) {
    return { key: "kind", values: { name, kinds: MESH_KINDS.join(", ") } };
  }
  const megabytes = (bytes: number): string => String(Math.ceil(bytes / 1e6));
  if (size_bytes <= MAX_FILE_BYTES) return null;
  return { key: "large", values: { name, size: megabytes(size_bytes), limit: megabytes(MAX_FILE_BYTES) } };
}

/** Return the kind of a file by the end of its name, in small letters. */
export function fileKind(name: string): string {
  return name.split(".").at(-1)?.toLowerCase() ?? "";
}

/** Distance below which corners are one [m]: files write each corner once for every triangle. */
const SAME_CORNER_M = 1e-5;

/** Cubes along an edge: so many at most, for their numbers to be exact; and the first ones of a simplified mesh. */
const MAX_GRID = 200_000;
const COARSE_GRID = 400;

/**
 * Make a mesh of loose triangles: with shared corners, about its middle, with as few triangles as the server takes.
 *
 * @param corners - coordinates of the triangles' corners, nine numbers each.
 * @param scale_m - length of their unit [m].
 * @throws Error when there is no triangle, or a coordinate that is no number.
 */
export function makeMesh(corners: ArrayLike<number>, scale_m: number, max_triangles = MAX_TRIANGLES): MadeMesh {
  const points = scaled(corners, scale_m);
  const size_m = Math.max(...centre(points));
  const whole = joined(loose(points), Math.max(SAME_CORNER_M, size_m / MAX_GRID), size_m);
  let mesh: MadeMesh = { ...whole, deviation_m: 0 };
  let grid_m = size_m / COARSE_GRID;
  while (mesh.triangles.length > max_triangles) {
    mesh = joined(whole, grid_m, size_m);
    // The number of triangles of a surface goes with the square of the grid.
    grid_m *= Math.max(1.1, Math.sqrt(mesh.triangles.length / max_triangles));
  }
  if (mesh.triangles.length === 0) throw new Error(t("world.file.no_area"));
  return mesh;
}

function loose(points: Float64Array): Pick<MadeMesh, "vertices" | "triangles"> {
  const vertices: Point[] = [];
  const triangles: Shape["triangles"] = [];
  for (let at = 0; at < points.length; at += 3) vertices.push([points[at] ?? 0, points[at + 1] ?? 0, points[at + 2] ?? 0]);
  for (let at = 0; at < vertices.length; at += 3) triangles.push([at, at + 1, at + 2]);
  return { vertices, triangles };
}

function scaled(corners: ArrayLike<number>, scale_m: number): Float64Array {
  const points = new Float64Array(corners.length - (corners.length % 9));
  for (let index = 0; index < points.length; index += 1) {
    const value = (corners[index] ?? 0) * scale_m;
    if (!Number.isFinite(value)) throw new Error(t("world.file.no_number", { corner: Math.floor(index / 3) }));
    points[index] = value;
  }
  return points;
}

/** Move points so that the middle of their box is the origin; return the sizes of the box. */
function centre(points: Float64Array): Point {
  const sizes: Point = [0, 0, 0];
  for (let axis = 0; axis < 3; axis += 1) {
    let [low, high] = [Infinity, -Infinity];
    for (let index = axis; index < points.length; index += 3) {
      low = Math.min(low, points[index] ?? 0);
      high = Math.max(high, points[index] ?? 0);
    }
    for (let index = axis; index < points.length; index += 3) points[index]! -= (low + high) / 2;
    sizes[axis] = high - low;
  }
  return sizes;
}

/** Join the corners in each cube of a grid to the first of them; triangles without an area, or twice there, fall away. */
function joined(mesh: Pick<MadeMesh, "vertices" | "triangles">, grid_m: number, size_m: number): MadeMesh {
  const known = new Map<number, number>();
  const vertices: Point[] = [];
  // The corners are about the origin.
  const half = Math.ceil(size_m / grid_m / 2) + 1;
  let deviation_m = 0;
  const index_of = Int32Array.from(mesh.vertices, (point) => {
    const [i, j, k] = [Math.round(point[0] / grid_m), Math.round(point[1] / grid_m), Math.round(point[2] / grid_m)];
    const key = ((i + half) * 2 * half + j + half) * 2 * half + k + half;
    const found = known.get(key);
    if (found === undefined) {
      known.set(key, vertices.length);
      return vertices.push(point) - 1;
    }
    const [x, y, z] = vertices[found] ?? point;
    deviation_m = Math.max(deviation_m, Math.hypot(x - point[0], y - point[1], z - point[2]));
    return found;
  });
  const seen = new Set<number>();
  const triangles: Shape["triangles"] = [];
  for (const corners of mesh.triangles) {
    const [a, b, c] = corners.map((corner) => index_of[corner] ?? 0) as [number, number, number];
    if (a === b || b === c || c === a) continue;
    const low = Math.min(a, b, c);
    const high = Math.max(a, b, c);
    const key = (low * MAX_GRID + (a + b + c - low - high)) * MAX_GRID + high;
    // Keys are exact up to so many corners; a mesh with more is joined anew.
    if (high < MAX_GRID && seen.has(key)) continue;
    seen.add(key);
    triangles.push([a, b, c]);
  }
  return { vertices, triangles, deviation_m };
}
