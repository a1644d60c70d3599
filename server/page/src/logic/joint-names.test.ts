import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { armJoints, gripperJoint, limitsOf, present, shownJoints } from "./joint-names";

const empty = emptyState("ws://here");
const urdf = `<robot><joint name="a" type="revolute"><limit effort="1" lower="-1" upper="1"/></joint>
<joint name='gripper' type='revolute'><limit lower='0' upper='1.5'/></joint>
<joint name="fixed" type="fixed"><parent link="x"/></joint></robot>`;
const limits: Record<string, [number, number]> = { a: [-0.5, 2], gripper: [-1, 1] };

test("limits are those of the server within those of the description", () => {
  expect(limitsOf({ limits, urdf })).toEqual({ a: [-0.5, 1], gripper: [0, 1] });
  expect(limitsOf({ limits: {}, urdf })).toEqual({ a: [-1, 1], gripper: [0, 1.5] });
  expect(limitsOf({ limits: { a: [3, 4] }, urdf })).toEqual({ a: [3, 4] });
});

test("joints of the arm are those of the named states, or all but the gripper", () => {
  const named = { home: { saved: false, joints: { gripper: 0 } } };
  expect(armJoints({ ...empty, limits })).toEqual(["a"]);
  expect(gripperJoint({ ...empty, limits })).toBe("gripper");
  expect(armJoints({ ...empty, limits, named })).toEqual(["gripper"]);
  expect(gripperJoint({ ...empty, limits: { a: [0, 1] } })).toBeNull();
});

test("a row shows the wish, else where the joint is, and nothing for what is no number", () => {
  const joints = { ...empty.joints, names: ["a", "b", "c"], position_rad: [1, Number.NaN, 3] };
  expect(present({ joints })).toEqual({ a: 1, c: 3 });
  const wish = { kind: "joints" as const, joints_rad: { a: 2 } };
  expect(shownJoints({ ...empty, joints, wish })).toEqual({ a: 2, c: 3 });
  expect(shownJoints({ ...empty, joints })).toEqual({ a: 1, c: 3 });
});
