import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { startsHere } from "./shown-plans";

const empty = emptyState("ws://here");
const arm = { ...empty.arm, mode: "holding" };
const plan = {
  names: ["a"],
  points: [
    { time_s: 0, position_rad: [0] },
    { time_s: 1, position_rad: [1] },
  ],
};
const at = (position: number): typeof empty.joints => ({ ...empty.joints, names: ["a"], position_rad: [position] });

test("a plan is shown where it can be carried out, and not after it was", () => {
  expect(startsHere(plan, { joints: at(0.01), arm })).toBe(true);
  expect(startsHere(plan, { joints: at(0.5), arm })).toBe(false);
  expect(startsHere(plan, { joints: at(1), arm })).toBe(false);
  expect(startsHere(plan, { joints: at(0), arm: { ...arm, mode: "moving" } })).toBe(false);
  expect(startsHere({ ...plan, names: ["unknown"] }, { joints: at(0), arm })).toBe(false);
});
