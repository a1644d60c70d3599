import type { NewObject, Orientation, Point, SceneObject, Shape, SurfacePoint } from "../state/state";

export const SIZED_KINDS = ["box", "sphere", "cylinder"] as const;

export type SizedKind = (typeof SIZED_KINDS)[number];

/** Least and greatest size of an object on a table, and the greatest coordinate [m]. */
export const MIN_SIZE_M = 0.001;
export const MAX_SIZE_M = 2;
export const MAX_PLACE_M = 2;

export const MAX_NAME_LENGTH = 60;

/** Sizes of a new object [m], which the gripper can hold, in the order of SolidPrimitive.dimensions. */
export const INITIAL_SIZES_M: Record<SizedKind, readonly number[]> = {
  box: [0.04, 0.04, 0.08],
  sphere: [0.025],
  cylinder: [0.08, 0.02],
};

/** Size of an object that the user can edit: its name, and its value [m]. */
export interface Size {
  name: "x" | "y" | "z" | "radius" | "height";
  value_m: number;
}

const SIZE_NAMES: Record<SizedKind, readonly Size["name"][]> = {
  box: ["x", "y", "z"],
  sphere: ["radius"],
  cylinder: ["height", "radius"],
};

const AT_ORIGIN: { position_m: Point; orientation: Orientation } = { position_m: [0, 0, 0], orientation: [0, 0, 0, 1] };

export function sizedShape(kind: SizedKind, dimensions: readonly number[]): Shape {
  return { kind, ...AT_ORIGIN, dimensions: [...dimensions], vertices: [], triangles: [] };
}

export function meshShape(vertices: Point[], triangles: Shape["triangles"]): Shape {
  return { kind: "mesh", ...AT_ORIGIN, dimensions: [], vertices, triangles };
}

export function sizesOf({ kind, dimensions }: Pick<Shape, "kind" | "dimensions">): Size[] {
  return (SIZE_NAMES[kind as SizedKind] ?? []).map((name, index) => ({ name, value_m: dimensions[index] ?? 0 }));
}

export function withSize(object: SceneObject, index: number, value_m: number): SceneObject {
  const shapes = object.shapes.map((shape) => ({
    ...shape,
    dimensions: shape.dimensions.map((size_m, at) => (at === index ? value_m : size_m)),
  }));
  return { ...object, shapes };
}

/** Return a name that is not taken: with the number after the highest. */
export function freeName(start: string, objects: readonly Pick<SceneObject, "id">[]): string {
  const taken = new Set(objects.map(({ id }) => id));
  const stem = start.replace(/_\d+$/, "").slice(0, MAX_NAME_LENGTH - 5);
  let number = 1;
  while (taken.has(`${stem}_${number}`)) number += 1;
  return `${stem}_${number}`;
}

export type NameProblem = "" | "empty" | "long" | "taken";

/** Return the reason why an object cannot have a name; empty when it can. */
export function nameProblem(name: string, present: string, objects: readonly Pick<SceneObject, "id">[]): NameProblem {
  if (name === "") return "empty";
  if (name.length > MAX_NAME_LENGTH) return "long";
  return name !== present && objects.some(({ id }) => id === name) ? "taken" : "";
}

/** Return how far a shape at the origin reaches in a direction of length 1 [m]. */
export function extent_m({ kind, dimensions, vertices }: Shape, [x, y, z]: Point): number {
  const [first = 0, second = 0, third = 0] = dimensions;
  switch (kind) {
    case "box":
      return (Math.abs(x) * first + Math.abs(y) * second + Math.abs(z) * third) / 2;
    case "sphere":
      return first;
    case "cylinder":
      return (Math.abs(z) * first) / 2 + second * Math.hypot(x, y);
    default:
      return vertices.reduce((most, vertex) => Math.max(most, vertex[0] * x + vertex[1] * y + vertex[2] * z), 0);
  }
}

export function placedOn({ name, shape }: NewObject, { point_m, normal }: SurfacePoint, objects: readonly SceneObject[]): SceneObject {
  const [x, y, z] = normal;
  const lift_m = extent_m(shape, [-x, -y, -z]);
  const at = (axis: number): number => rounded((point_m[axis] ?? 0) + (normal[axis] ?? 0) * lift_m);
  return newObject({ name, shape }, [at(0), at(1), at(2)], objects);
}

export function newObject({ name, shape }: NewObject, position_m: Point, objects: readonly SceneObject[]): SceneObject {
  return {
    id: freeName(name, objects),
    frame: "",
    attached: false,
    position_m,
    orientation: [0, 0, 0, 1],
    shapes: [shape],
    color: null,
  };
}

/** Return a copy beside an object, along y. */
export function duplicateOf(object: SceneObject, objects: readonly SceneObject[]): SceneObject {
  const [x, y, z] = object.position_m;
  const width_m = Math.max(...object.shapes.map((shape) => extent_m(shape, [0, 1, 0]) + extent_m(shape, [0, -1, 0])), 0);
  // A finger's width between them, so that each can be clicked.
  return { ...object, id: freeName(object.id, objects), position_m: [x, rounded(y + width_m + 0.02), z] };
}

function rounded(value_m: number): number {
  return Number(value_m.toFixed(4));
}
