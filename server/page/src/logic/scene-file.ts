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
