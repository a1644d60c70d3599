import { expect, test } from "vitest";
import type { SceneObject } from "../state/state";
import { duplicateOf, extent_m, freeName, meshShape, nameProblem, placedOn, sizedShape, sizesOf, withSize } from "./scene-objects";

const box = sizedShape("box", [0.04, 0.06, 0.08]);
const object = (id: string): SceneObject => ({
  id,
  frame: "",
  attached: false,
  position_m: [0.1, 0.2, 0.3],
  orientation: [0, 0, 0, 1],
  shapes: [box],
  color: [1, 0, 0, 1],
});

test("a placed object stands on the surface that was clicked", () => {
  const up = { point_m: [0.2, 0.1, 0] as [number, number, number], normal: [0, 0, 1] as [number, number, number] };
  expect(placedOn({ name: "box", shape: box }, up, [])).toMatchObject({ id: "box_1", position_m: [0.2, 0.1, 0.04] });
  const side = { ...up, normal: [0, -1, 0] as [number, number, number] };
  expect(placedOn({ name: "box", shape: box }, side, []).position_m).toEqual([0.2, 0.07, 0]);
});

test.each([
  [box, [0, 0, 1], 0.04],
  [sizedShape("sphere", [0.03]), [0, 1, 0], 0.03],
  [sizedShape("cylinder", [0.1, 0.02]), [0, 0, -1], 0.05],
  [sizedShape("cylinder", [0.1, 0.02]), [1, 0, 0], 0.02],
  [meshShape([[0, 0, -0.02], [0, 0, 0.05], [1, 0, 0]], [[0, 1, 2]]), [0, 0, -1], 0.02],
] as const)("a shape reaches so far", (shape, direction, extent) => {
  expect(extent_m(shape, [...direction])).toBeCloseTo(extent);
});

test("names are counted on, and copies stand beside the object with all that it has", () => {
  expect(freeName("box", [{ id: "box_1" }, { id: "box_3" }])).toBe("box_2");
  expect(duplicateOf(object("cup_1"), [object("cup_1")])).toMatchObject({
    id: "cup_2",
    position_m: [0.1, 0.28, 0.3],
    color: [1, 0, 0, 1],
  });
});

test.each([
  ["cup", ""],
  ["", "empty"],
  ["x".repeat(61), "long"],
  ["pen", "taken"],
])("the name %s has the problem '%s'", (name, problem) => {
  expect(nameProblem(name, "cup", [object("cup"), object("pen")])).toBe(problem);
});

test("sizes have the names of their shape, in the order of the message", () => {
  expect(sizesOf(sizedShape("cylinder", [0.1, 0.02]))).toEqual([
    { name: "height", value_m: 0.1 },
    { name: "radius", value_m: 0.02 },
  ]);
  expect(sizesOf(meshShape([], []))).toEqual([]);
  expect(withSize(object("a"), 1, 0.5).shapes[0]?.dimensions).toEqual([0.04, 0.5, 0.08]);
});
