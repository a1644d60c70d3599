import { expect, test } from "vitest";
import type { SceneChange, SceneObject } from "../state/state";
import { MAX_CHANGES, undoing, withChange } from "./scene-history";

const object = (id: string, attached = false): SceneObject => ({
  id,
  frame: attached ? "hand" : "base",
  attached,
  position_m: [0, 0, 0],
  orientation: [0, 0, 0, 1],
  shapes: [],
  color: null,
});
const before = (ids: string[], objects: SceneObject[]): SceneChange => ({ ids, objects });
const nothing = { added: [], attached: [], detached: [], removed: [] };
const [cup, pen] = [object("cup"), object("pen")];

test("what was added is removed, what was removed is added, what was moved is put back", () => {
  expect(undoing(before(["cup"], []), [cup])).toEqual({ ...nothing, removed: ["cup"] });
  expect(undoing(before(["cup"], [cup]), [])).toEqual({ ...nothing, added: [cup] });
  expect(undoing(before(["cup"], [cup]), [{ ...cup, position_m: [1, 0, 0] }, pen])).toEqual({ ...nothing, added: [cup] });
});

test("what is as it was stays alone", () => {
  expect(undoing(before(["cup", "pen"], [cup]), [cup])).toEqual(nothing);
});

test("what was attached is detached before it is put back or removed", () => {
  const held = object("cup", true);
  expect(undoing(before(["cup"], [cup]), [held])).toEqual({ ...nothing, detached: ["cup"], added: [cup] });
  expect(undoing(before(["cup"], []), [held])).toEqual({ ...nothing, detached: ["cup"], removed: ["cup"] });
  expect(undoing(before(["cup"], [held]), [cup])).toEqual({ ...nothing, attached: [held] });
});

test("a replaced scene comes back as a whole", () => {
  expect(undoing({ ids: null, objects: [cup] }, [pen])).toEqual({ ...nothing, added: [cup], removed: ["pen"] });
});

test("the oldest changes are forgotten", () => {
  let history: ReturnType<typeof withChange> = [];
  for (let count = 0; count < MAX_CHANGES + 5; count += 1) history = withChange(history, before([String(count)], []));
  expect(history).toHaveLength(MAX_CHANGES);
  expect(history.at(-1)?.ids).toEqual([String(MAX_CHANGES + 4)]);
});
