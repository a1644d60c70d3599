import type { Point, Shape } from "../state/state";

/** Corners and triangles of a closed or open surface. */
export interface Surface {
  vertices: Point[];
  triangles: [number, number, number][];
}

/** Why a shape cannot be drawn, as a phrase; empty when it can. */
export function shapeProblem(shape: Shape): string {
  const wanted = SIZES[shape.kind];
  const sizes = shape.dimensions.slice(0, wanted);
  if (sizes.length < wanted) return `a ${shape.kind} has ${wanted} sizes, not ${sizes.length}`;
  const numbers = [...sizes, ...shape.position_m, ...shape.orientation, ...shape.vertices.flat()];
  if (!numbers.every(Number.isFinite)) return `a ${shape.kind} has a number that is none`;
  if (shape.kind === "plane") return Math.hypot(...sizes.slice(0, 3)) > 0 ? "" : "a plane has no direction";
  if (sizes.some((size) => size <= 0)) return `a ${shape.kind} has a size of ${Math.min(...sizes)} m`;
  return surfaceProblem(shape);
}

const SIZES: Record<Shape["kind"], number> = {
  box: 3,
  sphere: 1,
  cylinder: 2,
  cone: 2,
  prism: 1,
  plane: 4,
  mesh: 0,
};

function surfaceProblem(shape: Shape): string {
  const corners = shape.vertices.length;
  if (shape.kind === "prism" && corners < 3) return `a prism has ${corners} corners`;
  if (shape.kind !== "mesh") return "";
  if (shape.triangles.length === 0) return "a mesh has no triangles";
  const outside = shape.triangles.flat().find((index) => !(index >= 0 && index < corners));
  return outside === undefined ? "" : `a mesh names corner ${outside} of ${corners}`;
}

/** The sides of a prism, half its height below and above its polygon; its ends are three's to fill. */
export function prismSides(polygon: readonly Point[], height_m: number): Surface {
  const count = polygon.length;
  const ring = (z: number): Point[] => polygon.map(([x, y]) => [x, y, z]);
  const triangles = polygon.flatMap((_, index): Surface["triangles"] => {
    const next = (index + 1) % count;
    return [
      [index, next, count + index],
      [next, count + next, count + index],
    ];
  });
  return { vertices: [...ring(-height_m / 2), ...ring(height_m / 2)], triangles };
}

/** The point of the plane a x + b y + c z + d = 0 that is nearest to the origin, and its unit normal. */
export function planeFrame(coefficients: readonly number[]): { point_m: Point; normal: Point } {
  const [a = 0, b = 0, c = 1, d = 0] = coefficients;
  const length = Math.hypot(a, b, c);
  const normal: Point = [a / length, b / length, c / length];
  const offset = -d / length;
  return { point_m: [normal[0] * offset, normal[1] * offset, normal[2] * offset], normal };
}
