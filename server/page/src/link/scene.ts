import type { Point, SceneObject, Shape } from "../state/state";
import type { CollisionObject, PlanningScene, Pose } from "./wire";

const KINDS: Record<number, Shape["kind"]> = { 1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism" };

/** moveit_msgs/CollisionObject.REMOVE. */
const REMOVE = 1;

/** The scene's objects after a message of /monitored_planning_scene, which says all or what changed. */
export function sceneObjects(known: readonly SceneObject[], scene: PlanningScene): SceneObject[] {
  const objects = new Map(scene.is_diff ? known.map((object) => [object.id, object]) : []);
  for (const told of scene.world.collision_objects) {
    if (told.operation !== REMOVE) objects.set(told.id, sceneObject(told, false, told.header.frame_id));
    else if (told.id === "") dropStanding(objects);
    else if (!objects.get(told.id)?.held) objects.delete(told.id);
  }
  const { robot_state } = scene;
  if (scene.is_diff && !robot_state.is_diff && robot_state.attached_collision_objects.length > 0) dropHeld(objects);
  for (const { link_name, object } of robot_state.attached_collision_objects) {
    if (object.operation === REMOVE) {
      if (objects.get(object.id)?.held) objects.delete(object.id);
    } else objects.set(object.id, sceneObject(object, true, object.header.frame_id || link_name));
  }
  return coloured([...objects.values()], scene);
}

function dropStanding(objects: Map<string, SceneObject>): void {
  for (const object of [...objects.values()]) if (!object.held) objects.delete(object.id);
}

function dropHeld(objects: Map<string, SceneObject>): void {
  for (const object of [...objects.values()]) if (object.held) objects.delete(object.id);
}

function coloured(objects: SceneObject[], scene: PlanningScene): SceneObject[] {
  const colors = new Map(scene.object_colors.map(({ id, color }) => [id, color]));
  return objects.map((object) => {
    const color = colors.get(object.id);
    return color ? { ...object, color: [color.r, color.g, color.b, color.a] } : object;
  });
}

function sceneObject(told: CollisionObject, held: boolean, frame: string): SceneObject {
  const shapes: Shape[] = [
    ...told.primitives.map((primitive, index) => ({
      // A kind that nobody knows has no dimensions that would do: it is left out, and told.
      ...shape(KINDS[primitive.type] ?? "box", told.primitive_poses[index]),
      dimensions: primitive.type in KINDS ? primitive.dimensions : [],
      vertices: (primitive.polygon?.points ?? []).map(point),
    })),
    ...told.meshes.map((mesh, index) => ({
      ...shape("mesh", told.mesh_poses[index]),
      vertices: mesh.vertices.map(point),
      triangles: mesh.triangles.map(({ vertex_indices: [a = 0, b = 0, c = 0] }) => [a, b, c] as [number, number, number]),
    })),
    ...told.planes.map((plane, index) => ({ ...shape("plane", told.plane_poses[index]), dimensions: plane.coef })),
  ];
  return { id: told.id, frame, held, ...placed(told.pose), shapes, color: null };
}

function shape(kind: Shape["kind"], pose: Pose | undefined): Shape {
  return { kind, ...placed(pose), dimensions: [], vertices: [], triangles: [] };
}

function placed(pose: Pose | undefined): Pick<SceneObject, "position_m" | "orientation"> {
  if (!pose) return { position_m: [0, 0, 0], orientation: [0, 0, 0, 1] };
  const { x, y, z, w } = pose.orientation;
  // A quaternion of noughts is what a sparse message has: it means not turned.
  const turned = Math.hypot(x, y, z, w) > 1e-9;
  return { position_m: point(pose.position), orientation: turned ? [x, y, z, w] : [0, 0, 0, 1] };
}

function point({ x, y, z }: { x: number | null; y: number | null; z: number | null }): Point {
  return [x ?? Number.NaN, y ?? Number.NaN, z ?? Number.NaN];
}
