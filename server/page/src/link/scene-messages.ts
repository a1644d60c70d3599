import type { SceneDifference } from "../logic/scene-history";
import type { Color, Orientation, Point, SceneObject, Shape } from "../state/state";
import { HEADER, pose } from "./messages";

/** Operations of moveit_msgs/CollisionObject. */
const ADD = 0;
const REMOVE = 1;
const MOVE = 3;

/** Types of shape_msgs/SolidPrimitive. */
const PRIMITIVES: Partial<Record<Shape["kind"], number>> = { box: 1, sphere: 2, cylinder: 3, cone: 4, prism: 5 };

/** Build moveit_msgs/CollisionObject ADD of an object with its shapes. */
export function addObject({ id, frame, position_m, orientation, shapes }: SceneObject): object {
  const solids = shapes.filter(({ kind }) => kind in PRIMITIVES);
  const meshes = shapes.filter(({ kind }) => kind === "mesh");
  const planes = shapes.filter(({ kind }) => kind === "plane");
  const poses = (of: Shape[]): object[] => of.map((shape) => pose(shape.position_m, shape.orientation));
  return {
    header: { ...HEADER, frame_id: frame },
    id,
    pose: pose(position_m, orientation),
    primitives: solids.map(({ kind, dimensions, vertices }) => ({
      type: PRIMITIVES[kind],
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

/** Build moveit_msgs/CollisionObject MOVE to a pose in the root link. */
export function moveObject(id: string, position_m: Point, orientation: Orientation): object {
  return { header: HEADER, id, pose: pose(position_m, orientation), operation: MOVE };
}

/** Build moveit_msgs/CollisionObject REMOVE. */
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

/** Parts of a difference of the scene. */
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

/** Return the parts of a difference; colours are told where there are any. */
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
