import { expect, test } from "vitest";
import { readSceneText, sceneText } from "./planning-scene";

const scene = {
  world: { collision_objects: [{ id: "cup" }] },
  robot_state: { attached_collision_objects: [{ link_name: "hand" }], joint_state: { name: ["a"] } },
  object_colors: [{ id: "cup" }],
  allowed_collision_matrix: {},
};

test("a file has the objects alone, and replaces the whole scene", () => {
  expect(readSceneText(sceneText(scene))).toEqual({
    is_diff: false,
    world: { collision_objects: [{ id: "cup" }] },
    robot_state: { attached_collision_objects: [{ link_name: "hand" }] },
    object_colors: [{ id: "cup" }],
  });
});

test.each(["", "{", "null", "[]", "{}", '{"world": {"collision_objects": 3}}'])("%s is no scene", (text) => {
  expect(readSceneText(text)).toBeNull();
});
