import { expect, test } from "vitest";
import { undoing } from "../logic/scene-history";
import { meshShape, newObject, sizedShape } from "../logic/scene-objects";
import { applyColors, applyPlanningScene } from "./planning-scene";
import { addObject, attachObject, detachObject, differenceMessage, moveObject, removeObject, sceneDiff } from "./planning-scene";
import type { PlanningScene } from "./messages";

const cup = newObject({ name: "cup", shape: sizedShape("cylinder", [0.1, 0.02]) }, [0.1, 0.2, 0.3], []);

test("an object is spelled as ROS has it, and read as it was", () => {
  const mesh = newObject({ name: "part", shape: meshShape([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]) }, [0, 0, 0], []);
  const scene = sceneDiff({ world: [addObject(cup), addObject(mesh)] }) as PlanningScene;
  expect(scene.world.collision_objects[0]?.primitives).toEqual([{ type: 3, dimensions: [0.1, 0.02], polygon: { points: [] } }]);
  expect(applyPlanningScene([], scene)).toEqual([cup, mesh]);
});

test("moves and removals name the object alone", () => {
  expect(moveObject("cup", [0, 0, 1], [0, 0, 0, 1])).toMatchObject({ id: "cup", operation: 3, pose: { position: { z: 1 } } });
  expect(removeObject("cup")).toMatchObject({ id: "cup", operation: 1 });
});

test("attaching names the link and what may touch, detaching neither", () => {
  expect(attachObject("cup", "tip", ["jaw"])).toMatchObject({ link_name: "tip", touch_links: ["jaw"], object: { id: "cup", operation: 0 } });
  expect(detachObject("cup")).toMatchObject({ link_name: "", object: { id: "cup", operation: 1 } });
});

test("an undone attachment gives the object back to the world, with its colour", () => {
  const red = { ...cup, color: [1, 0, 0, 1] as [number, number, number, number] };
  const held = { ...red, frame: "tip", attached: true, touch_links: ["jaw"] };
  const difference = undoing({ ids: ["cup_1"], objects: [red] }, [held]);
  const scene = sceneDiff(differenceMessage(difference)) as PlanningScene;
  // The server has an object in the world only after its link has let go of it.
  expect(scene.robot_state.attached_collision_objects).toMatchObject([{ object: { id: "cup_1", operation: 1 } }]);
  const [object] = applyPlanningScene([held], scene, applyColors({}, scene));
  expect(object).toEqual(red);
});

test("a colour of four zeros is none", () => {
  const scene = sceneDiff({ colors: { cup_1: null } }) as PlanningScene;
  expect(applyColors({ cup_1: [1, 0, 0, 1], pen: [0, 0, 1, 1] }, scene)).toEqual({ pen: [0, 0, 1, 1] });
});
