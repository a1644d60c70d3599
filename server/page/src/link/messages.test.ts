import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { addBox, jointGoal, jointJog, moveGroupGoal, pointGoal, wishedGoal } from "./messages";

const empty = emptyState("ws://here");

test("without a wish nothing is asked for", () => {
  expect(wishedGoal(empty)).toBeNull();
});

test("a wish for joints or a named state is a goal for exactly these joints", () => {
  const wish = { kind: "named" as const, joints_rad: { elbow_flex: 0.5 } };
  expect(wishedGoal({ ...empty, wish })).toEqual({
    joint_constraints: [
      { joint_name: "elbow_flex", position: 0.5, tolerance_above: 1e-4, tolerance_below: 1e-4, weight: 1 },
    ],
  });
});

test("a target that can be reached is asked for as the ghost shows it, any other as a point", () => {
  const wish = { kind: "target" as const, joints_rad: null };
  const target = { ...empty.target, position_m: [0.3, 0, 0.2] as [number, number, number], joints_rad: { a: 1 } };
  expect(wishedGoal({ wish, target: { ...target, reachable: true } })).toEqual(jointGoal({ a: 1 }));
  expect(wishedGoal({ wish, target: { ...target, reachable: false } })).toEqual(pointGoal([0.3, 0, 0.2], 0.01));
  expect(wishedGoal({ wish, target: { ...target, reachable: null } })).toEqual(pointGoal([0.3, 0, 0.2], 0.01));
});

test("the speed goes into the request, and plan_only beside it", () => {
  expect(moveGroupGoal({}, 0.4, true)).toMatchObject({
    request: { max_velocity_scaling_factor: 0.4, max_acceleration_scaling_factor: 0.4, group_name: "" },
    planning_options: { plan_only: true },
  });
});

test("a box and a jog have the fields of their types", () => {
  expect(addBox("box 1", [0.1, 0.2, 0.3], [0.04, 0.05, 0.06])).toMatchObject({
    id: "box 1",
    operation: 0,
    primitives: [{ type: 1, dimensions: [0.04, 0.05, 0.06] }],
  });
  expect(jointJog({ elbow_flex: -1 })).toMatchObject({ joint_names: ["elbow_flex"], velocities: [-1] });
});
