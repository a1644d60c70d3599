import type { Color, Point, SceneObject, Shape } from "../state/state";
import { t } from "../texts/texts";
import type { CollisionObject, PlanningScene, Pose } from "./messages";

const SHAPE_KINDS: Record<number, Shape["kind"]> = { 1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism" };

/** moveit_msgs/CollisionObject.REMOVE. */
const REMOVE = 1;

/** Return the colours of objects after a message of /monitored_planning_scene; four zeros stand for none, as in MoveIt. */
export function applyColors(known: Record<string, Color>, scene: PlanningScene): Record<string, Color> {
  const told = scene.object_colors.map(({ id, color: { r, g, b, a } }) => [id, [r, g, b, a]] as const);
  const colors = { ...(scene.is_diff ? known : {}), ...(Object.fromEntries(told) as Record<string, Color>) };
  return Object.fromEntries(Object.entries(colors).filter(([, color]) => color.some((part) => part > 0)));
}

/** Return the objects, with their colours after it, after a message of /monitored_planning_scene: the scene or a difference. */
export function applyPlanningScene(
  known: readonly SceneObject[],
  scene: PlanningScene,
  colors: Record<string, Color> = applyColors({}, scene),
): SceneObject[] {
  const objects = new Map(scene.is_diff ? known.map((object) => [object.id, object]) : []);
  for (const message of scene.world.collision_objects) {
    if (message.operation !== REMOVE) objects.set(message.id, readSceneObject(message, false, message.header.frame_id));
    else if (message.id === "") removeWorldObjects(objects);
    else if (!objects.get(message.id)?.attached) objects.delete(message.id);
  }
  const { robot_state } = scene;
  const replaces_attached = scene.is_diff && !robot_state.is_diff && robot_state.attached_collision_objects.length > 0;
  if (replaces_attached) removeAttachedObjects(objects);
  for (const { link_name, touch_links, object } of robot_state.attached_collision_objects) {
    if (object.operation === REMOVE) {
      if (objects.get(object.id)?.attached) objects.delete(object.id);
    } else {
      const read = readSceneObject(object, true, object.header.frame_id || link_name);
      objects.set(object.id, { ...read, touch_links: touch_links ?? [] });
    }
  }
  return [...objects.values()].map((object) => withColor(object, colors[object.id] ?? null));
}

function removeWorldObjects(objects: Map<string, SceneObject>): void {
  for (const object of [...objects.values()]) if (!object.attached) objects.delete(object.id);
}

function removeAttachedObjects(objects: Map<string, SceneObject>): void {
  for (const object of [...objects.values()]) if (object.attached) objects.delete(object.id);
}

/** Return an object with a colour; one that has it stays the same object, which is not drawn anew. */
function withColor(object: SceneObject, color: Color | null): SceneObject {
  return String(object.color) === String(color) ? object : { ...object, color };
}

function readSceneObject(message: CollisionObject, attached: boolean, frame: string): SceneObject {
  const shapes: Shape[] = [
    ...message.primitives.map((primitive, index) => ({
      // An unknown kind gets no dimensions, so that drawableObjects() leaves it out and reports it.
      ...readShape(SHAPE_KINDS[primitive.type] ?? "box", message.primitive_poses[index]),
      dimensions: primitive.type in SHAPE_KINDS ? primitive.dimensions : [],
      vertices: (primitive.polygon?.points ?? []).map(readPoint),
    })),
    ...message.meshes.map((mesh, index) => ({
      ...readShape("mesh", message.mesh_poses[index]),
      vertices: mesh.vertices.map(readPoint),
      triangles: mesh.triangles.map(readTriangle),
    })),
    ...message.planes.map((plane, index) => ({
      ...readShape("plane", message.plane_poses[index]),
      dimensions: plane.coef,
    })),
  ];
  return { id: message.id, frame, attached, ...readPose(message.pose), shapes, color: null };
}

function readShape(kind: Shape["kind"], pose: Pose | undefined): Shape {
  return { kind, ...readPose(pose), dimensions: [], vertices: [], triangles: [] };
}

function readPose(pose: Pose | undefined): Pick<SceneObject, "position_m" | "orientation"> {
  if (!pose) return { position_m: [0, 0, 0], orientation: [0, 0, 0, 1] };
  const { x, y, z, w } = pose.orientation;
  // Messages that leave out the orientation have a quaternion of zeros: no rotation.
  const has_rotation = Math.hypot(x, y, z, w) > 1e-9;
  return { position_m: readPoint(pose.position), orientation: has_rotation ? [x, y, z, w] : [0, 0, 0, 1] };
}

function readTriangle({ vertex_indices }: { vertex_indices: number[] }): [number, number, number] {
  const [a = 0, b = 0, c = 0] = vertex_indices;
  return [a, b, c];
}

function readPoint({ x, y, z }: { x: number | null; y: number | null; z: number | null }): Point {
  return [x ?? Number.NaN, y ?? Number.NaN, z ?? Number.NaN];
}

/** Return the objects that can be drawn, and a sentence for each that cannot, wholly or in part. */
export function drawableObjects(objects: readonly SceneObject[]): { objects: SceneObject[]; problems: string[] } {
  const problems: string[] = [];
  const drawn = objects.flatMap((object) => {
    if (![...object.position_m, ...object.orientation].every(Number.isFinite)) {
      problems.push(t("picture.object.no_place", { name: object.id }));
      return [];
    }
    const reasons = object.shapes.map(shapeProblem);
    const problem = reasons.find((text) => text !== "");
    if (problem === undefined) return [object];
    problems.push(t("picture.object.partly", { name: object.id, reason: problem }));
    return [{ ...object, shapes: object.shapes.filter((_, index) => reasons[index] === "") }];
  });
  return { objects: drawn, problems };
}

/** Return the reason that a shape cannot be drawn, as a phrase; empty when it can. */
export function shapeProblem(shape: Shape): string {
  const kind = t(`picture.shape.${shape.kind}`);
  const expected = DIMENSION_COUNTS[shape.kind];
  const sizes = shape.dimensions.slice(0, expected);
  if (sizes.length < expected) return t("picture.shape.sizes", { kind, expected, count: sizes.length });
  const numbers = [...sizes, ...shape.position_m, ...shape.orientation, ...shape.vertices.flat()];
  if (!numbers.every(Number.isFinite)) return t("picture.shape.no_number", { kind });
  if (shape.kind === "plane") return Math.hypot(...sizes.slice(0, 3)) > 0 ? "" : t("picture.shape.no_direction");
  if (sizes.some((size) => size <= 0)) return t("picture.shape.size", { kind, size_m: Math.min(...sizes) });
  return surfaceProblem(shape);
}

/** Length of SolidPrimitive.dimensions per kind; a plane has its four coefficients there, a mesh nothing. */
const DIMENSION_COUNTS: Record<Shape["kind"], number> = {
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
  if (shape.kind === "prism" && corners < 3) return t("picture.shape.corners", { corners });
  if (shape.kind !== "mesh") return "";
  if (shape.triangles.length === 0) return t("picture.shape.no_triangles");
  const outside = shape.triangles.flat().find((index) => !(index >= 0 && index < corners));
  return outside === undefined ? "" : t("picture.shape.corner", { corner: outside, corners });
}
