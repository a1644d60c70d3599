import { expect, test } from "vitest";
import { sceneObjects } from "./scene";
import type { CollisionObject, PlanningScene } from "./wire";

const pose = { position: { x: 0.1, y: 0.2, z: 0.3 }, orientation: { x: 0, y: 0, z: 0, w: 0 } };

function thing(id: string, operation = 0): CollisionObject {
  return {
    header: { frame_id: "base_link" },
    id,
    pose,
    primitives: operation === 0 ? [{ type: 1, dimensions: [0.1, 0.2, 0.3] }] : [],
    primitive_poses: operation === 0 ? [pose] : [],
    meshes: [],
    mesh_poses: [],
    planes: [],
    plane_poses: [],
    operation,
  };
}

function scene(world: CollisionObject[], held: CollisionObject[] = [], is_diff = true): PlanningScene {
  const attached_collision_objects = held.map((object) => ({ link_name: "gripper_link", object }));
  return {
    is_diff,
    robot_state: { is_diff: true, attached_collision_objects },
    world: { collision_objects: world },
    object_colors: [{ id: "red", color: { r: 1, g: 0, b: 0, a: 1 } }],
  };
}

const ids = (objects: { id: string }[]): string[] => objects.map(({ id }) => id);

test("a whole scene replaces what was known, a change adds and removes", () => {
  const whole = sceneObjects([], scene([thing("a"), thing("red")], [], false));
  expect(whole[0]).toMatchObject({ id: "a", frame: "base_link", held: false, position_m: [0.1, 0.2, 0.3], color: null });
  expect(whole[0]?.shapes[0]).toMatchObject({ kind: "box", dimensions: [0.1, 0.2, 0.3], orientation: [0, 0, 0, 1] });
  expect(whole[1]?.color).toEqual([1, 0, 0, 1]);
  expect(ids(sceneObjects(whole, scene([thing("b"), thing("a", 1)])))).toEqual(["red", "b"]);
  expect(ids(sceneObjects(whole, scene([thing("c")], [], false)))).toEqual(["c"]);
});

test("a thing that is taken stays one thing, and its removal from the world does not drop it", () => {
  const standing = sceneObjects([], scene([thing("a")]));
  const held = sceneObjects(standing, scene([thing("a", 1)], [thing("a")]));
  expect(held).toHaveLength(1);
  expect(held[0]?.held).toBe(true);
  expect(sceneObjects(held, scene([thing("a")], [thing("a", 1)]))).toHaveLength(1);
});

test("a removal without a name takes everything that stands", () => {
  expect(sceneObjects(sceneObjects([], scene([thing("a"), thing("b")])), scene([thing("", 1)]))).toEqual([]);
});
