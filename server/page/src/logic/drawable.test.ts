import { expect, test } from "vitest";
import type { SceneObject, Shape } from "../state/state";
import { drawable } from "./drawable";

const box: Shape = {
  kind: "box",
  position_m: [0, 0, 0],
  orientation: [0, 0, 0, 1],
  dimensions: [0.1, 0.1, 0.1],
  vertices: [],
  triangles: [],
};

function thing(shapes: Shape[], patch: Partial<SceneObject> = {}): SceneObject {
  const pose = { position_m: [0, 0, 0] as const, orientation: [0, 0, 0, 1] as const };
  return { id: "thing", frame: "base_link", held: false, ...structuredClone(pose), shapes, color: null, ...patch } as SceneObject;
}

test("a good thing stays the very same", () => {
  const good = thing([box]);
  expect(drawable([good])).toEqual({ objects: [good], problems: [] });
  expect(drawable([good]).objects[0]).toBe(good);
});

test("a shape that cannot be drawn is left out, and told", () => {
  const { objects, problems } = drawable([thing([box, { ...box, dimensions: [0.1, 0, 0.1] }])]);
  expect(objects[0]?.shapes).toEqual([box]);
  expect(problems).toEqual(["“thing” is not drawn as it is: a box has a size of 0 m."]);
});

test("a thing without a place is left out, and told", () => {
  const { objects, problems } = drawable([thing([box], { position_m: [Number.NaN, 0, 0] })]);
  expect(objects).toEqual([]);
  expect(problems[0]).toContain("no place");
});
