import type { SceneDifference } from "../logic/scene-history";
import type { Color, Orientation, Point, SceneObject, Shape } from "../state/state";
import { t } from "../texts/texts";
import { HEADER, pose, type CollisionObject, type PlanningScene, type Pose } from "./messages";

/** Types of shape_msgs/SolidPrimitive, which count from 1. */
const PRIMITIVES: readonly Shape["kind"][] = ["box", "sphere", "cylinder", "cone", "prism"];

const ADD = 0;
const REMOVE = 1;
const MOVE = 3;

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
    else if (message.id === "") removeObjects(objects, false);
    else if (!objects.get(message.id)?.attached) objects.delete(message.id);
  }
  const { robot_state } = scene;
  const replaces_attached = scene.is_diff && !robot_state.is_diff && robot_state.attached_collision_objects.length > 0;
  if (replaces_attached) removeObjects(objects, true);
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

function removeObjects(objects: Map<string, SceneObject>, attached: boolean): void {
  for (const object of [...objects.values()]) if (object.attached === attached) objects.delete(object.id);
}

/** Return an object with a colour; one that has it stays the same object, which is not drawn again. */
function withColor(object: SceneObject, color: Color | null): SceneObject {
  return String(object.color) === String(color) ? object : { ...object, color };
}

function readSceneObject(message: CollisionObject, attached: boolean, frame: string): SceneObject {
  const shapes: Shape[] = [
    ...message.primitives.map((primitive, index) => ({
      // An unknown kind gets no dimensions, so that drawableObjects() leaves it out and reports it.
      ...readShape(PRIMITIVES[primitive.type - 1] ?? "box", message.primitive_poses[index]),
      dimensions: primitive.type - 1 in PRIMITIVES ? primitive.dimensions : [],
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

/** Length of SolidPrimitive.dimensions per kind; a plane has its four coefficients there, a mesh nothing. */
const DIMENSION_COUNTS: Record<Shape["kind"], number> = { box: 3, sphere: 1, cylinder: 2, cone: 2, prism: 1, plane: 4, mesh: 0 };

/** Return the objects and shapes that can be drawn, and a sentence about each other object; the server checks the rest. */
export function drawableObjects(objects: readonly SceneObject[]): { objects: SceneObject[]; problems: string[] } {
  const problems: string[] = [];
  const drawn = objects.flatMap((object) => {
    const has_place = [...object.position_m, ...object.orientation].every(Number.isFinite);
    const shapes = object.shapes.filter(isDrawable);
    if (has_place && shapes.length === object.shapes.length) return [object];
    problems.push(t("picture.object.partly", { name: object.id }));
    return has_place ? [{ ...object, shapes }] : [];
  });
  return { objects: drawn, problems };
}

/** Return true for a shape with all its sizes, of numbers that are finite, and triangles with corners that exist. */
function isDrawable({ kind, dimensions, position_m, orientation, vertices, triangles }: Shape): boolean {
  const numbers = [...dimensions, ...position_m, ...orientation, ...vertices.flat()];
  const is_whole = dimensions.length >= DIMENSION_COUNTS[kind] && (kind !== "mesh" || triangles.length > 0);
  return is_whole && numbers.every(Number.isFinite) && triangles.flat().every((corner) => corner in vertices);
}

export function addObject({ id, frame, position_m, orientation, shapes }: SceneObject): object {
  const solids = shapes.filter(({ kind }) => PRIMITIVES.includes(kind));
  const meshes = shapes.filter(({ kind }) => kind === "mesh");
  const planes = shapes.filter(({ kind }) => kind === "plane");
  const poses = (of: Shape[]): object[] => of.map((shape) => pose(shape.position_m, shape.orientation));
  return {
    header: { ...HEADER, frame_id: frame },
    id,
    pose: pose(position_m, orientation),
    primitives: solids.map(({ kind, dimensions, vertices }) => ({
      type: PRIMITIVES.indexOf(kind) + 1,
      dimensions,
      polygon: { points: vertices.map(point) },
    })),
    primitive_poses: poses(solids),
    meshes: meshes.map(({ vertices, triangles }) => ({
      vertices: vertices.map(point),
      triangles: triangles.map((vertex_indices) => ({ vertex_indices })),
    })),
    mesh_poses: poses(meshes),
    planes: planes.map(({ dimensions }) => ({ coef: dimensions })),
    plane_poses: poses(planes),
    operation: ADD,
  };
}

/** Micrometres: more digits only make a mesh's message longer. */
function point([x, y, z]: Point): object {
  const rounded = (value: number): number => Math.round(value * 1e6) / 1e6;
  return { x: rounded(x), y: rounded(y), z: rounded(z) };
}

export function moveObject(id: string, position_m: Point, orientation: Orientation): object {
  return { header: HEADER, id, pose: pose(position_m, orientation), operation: MOVE };
}

export function removeObject(id: string): object {
  return { header: HEADER, id, operation: REMOVE };
}

/** Build moveit_msgs/AttachedCollisionObject of an object of the world, where it is. */
export function attachObject(id: string, link_name: string, touch_links: string[]): object {
  return { link_name, touch_links, object: { header: HEADER, id, operation: ADD } };
}

/** Build moveit_msgs/AttachedCollisionObject that puts an object back into the world, where it is. */
export function detachObject(id: string): object {
  return { link_name: "", object: { header: HEADER, id, operation: REMOVE } };
}

export interface SceneDiff {
  world?: object[];
  attached?: object[];
  colors?: Record<string, Color | null>;
}

/** Build moveit_msgs/PlanningScene as a difference: attached objects are changed before those of the world. */
export function sceneDiff({ world = [], attached = [], colors = {} }: SceneDiff): object {
  const object_colors = Object.entries(colors).map(([id, color]) => {
    const [r, g, b, a] = color ?? [0, 0, 0, 0];
    return { id, color: { r, g, b, a } };
  });
  return {
    is_diff: true,
    robot_state: { is_diff: true, attached_collision_objects: attached },
    world: { collision_objects: world },
    object_colors,
  };
}

export function differenceMessage({ added, attached, detached, removed }: SceneDifference): SceneDiff {
  const held = attached.map((object) => ({
    link_name: object.frame,
    touch_links: object.touch_links ?? [],
    object: addObject(object),
  }));
  const colored = [...added, ...attached].map(({ id, color }) => [id, color] as const);
  return {
    world: [...removed.map(removeObject), ...added.map(addObject)],
    attached: [...detached.map(detachObject), ...held],
    colors: Object.fromEntries(colored),
  };
}

/** Largest file of a scene that is read [bytes], as the server keeps them. */
export const MAX_SCENE_FILE_BYTES = 20_000_000;

/** Scene as a file has it: the parts of moveit_msgs/PlanningScene that tell of objects. */
export interface SceneFile {
  world: { collision_objects: unknown[] };
  robot_state: { attached_collision_objects: unknown[] };
  object_colors: unknown[];
}

/** Return the file's text of a moveit_msgs/PlanningScene: its objects, without joints and matrix. */
export function sceneText(scene: SceneFile): string {
  const { world, robot_state, object_colors } = scene;
  const { attached_collision_objects } = robot_state;
  const collision_objects = world.collision_objects;
  const content: SceneFile = { world: { collision_objects }, robot_state: { attached_collision_objects }, object_colors };
  return `${JSON.stringify(content, null, 1)}\n`;
}

/** Return the moveit_msgs/PlanningScene that replaces the present one by that of a file; null when it has none. */
export function readSceneText(text: string): object | null {
  try {
    const content = JSON.parse(text) as Partial<SceneFile> | null;
    const collision_objects = content?.world?.collision_objects;
    if (!Array.isArray(collision_objects)) return null;
    const attached_collision_objects = content?.robot_state?.attached_collision_objects ?? [];
    const object_colors = content?.object_colors ?? [];
    return { is_diff: false, world: { collision_objects }, robot_state: { attached_collision_objects }, object_colors };
  } catch {
    return null;
  }
}
