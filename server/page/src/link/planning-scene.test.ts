import { expect, test } from "vitest";
import type { SceneObject, Shape } from "../state/state";
import type { CollisionObject, PlanningScene } from "./messages";
import { applyPlanningScene, drawableObjects } from "./planning-scene";

const pose = { position: { x: 0.1, y: 0.2, z: 0.3 }, orientation: { x: 0, y: 0, z: 0, w: 0 } };

function collisionObject(id: string, operation = 0): CollisionObject {
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
  } as unknown as CollisionObject;
}

function planningScene(world: CollisionObject[], attached: CollisionObject[] = [], is_diff = true): PlanningScene {
  const attached_collision_objects = attached.map((object) => ({ link_name: "gripper_link", object }));
  return {
    is_diff,
    robot_state: { is_diff: true, attached_collision_objects },
    world: { collision_objects: world },
    object_colors: [{ id: "red", color: { r: 1, g: 0, b: 0, a: 1 } }],
  } as unknown as PlanningScene;
}

const ids = (objects: { id: string }[]): string[] => objects.map(({ id }) => id);

test("a whole scene replaces what was known, a change adds and removes", () => {
  const whole = applyPlanningScene([], planningScene([collisionObject("a"), collisionObject("red")], [], false));
  expect(whole[0]).toMatchObject({ id: "a", frame: "base_link", attached: false, position_m: [0.1, 0.2, 0.3], color: null });
  expect(whole[0]?.shapes[0]).toMatchObject({ kind: "box", dimensions: [0.1, 0.2, 0.3], orientation: [0, 0, 0, 1] });
  expect(whole[1]?.color).toEqual([1, 0, 0, 1]);
  expect(ids(applyPlanningScene(whole, planningScene([collisionObject("b"), collisionObject("a", 1)])))).toEqual(["red", "b"]);
  expect(ids(applyPlanningScene(whole, planningScene([collisionObject("c")], [], false)))).toEqual(["c"]);
});

test("a thing that is taken stays one thing, and its removal from the world does not drop it", () => {
  const standing = applyPlanningScene([], planningScene([collisionObject("a")]));
  const attached = applyPlanningScene(standing, planningScene([collisionObject("a", 1)], [collisionObject("a")]));
  expect(attached).toHaveLength(1);
  expect(attached[0]?.attached).toBe(true);
  expect(applyPlanningScene(attached, planningScene([collisionObject("a")], [collisionObject("a", 1)]))).toHaveLength(1);
});

test("a removal without a name takes everything that stands", () => {
  expect(applyPlanningScene(applyPlanningScene([], planningScene([collisionObject("a"), collisionObject("b")])), planningScene([collisionObject("", 1)]))).toEqual([]);
});

const box: Shape = {
  kind: "box",
  position_m: [0, 0, 0],
  orientation: [0, 0, 0, 1],
  dimensions: [0.1, 0.1, 0.1],
  vertices: [],
  triangles: [],
};

function sceneObject(shapes: Shape[], patch: Partial<SceneObject> = {}): SceneObject {
  const pose = { position_m: [0, 0, 0] as const, orientation: [0, 0, 0, 1] as const };
  return { id: "thing", frame: "base_link", attached: false, ...structuredClone(pose), shapes, color: null, ...patch } as SceneObject;
}

test("a good thing stays the very same", () => {
  const good = sceneObject([box]);
  expect(drawableObjects([good])).toEqual({ objects: [good], problems: [] });
  expect(drawableObjects([good]).objects[0]).toBe(good);
});

test.each<[string, Partial<Shape>]>([
  ["missing sizes", { dimensions: [0.1] }],
  ["sizes that are no numbers", { dimensions: [0.1, Number.NaN, 0.1] }],
  ["NaN", { position_m: [0, Number.NaN, 0] }],
  ["an empty mesh", { kind: "mesh" }],
  ["a corner that is not there", { kind: "mesh", vertices: [[0, 0, 0]], triangles: [[0, 1, 0]] }],
])("a shape with %s is left out, with a sentence", (_, patch) => {
  const { objects, problems } = drawableObjects([sceneObject([box, { ...box, ...patch }])]);
  expect(objects[0]?.shapes).toEqual([box]);
  expect(problems).toEqual([expect.stringContaining("“thing”")]);
});

test("whole shapes are drawn", () => {
  const plane: Shape = { ...box, kind: "plane", dimensions: [0, 0, 1, -0.2] };
  const mesh: Shape = { ...box, kind: "mesh", dimensions: [], vertices: [[0, 0, 0]], triangles: [[0, 0, 0]] };
  expect(drawableObjects([sceneObject([plane, mesh])]).problems).toEqual([]);
});

test("an object without a place is left out, with a sentence", () => {
  const { objects, problems } = drawableObjects([sceneObject([box], { position_m: [Number.NaN, 0, 0] })]);
  expect(objects).toEqual([]);
  expect(problems).toHaveLength(1);
});
