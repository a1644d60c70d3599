import { describe, expect, it, test } from "vitest";
import { emptyState } from "../state/state";
import {
  armJoints,
  currentPositions,
  displayedPositions,
  gripperJoint,
  jointLimits,
  jointReport,
  looksEqual,
  unknownNamesText,
  withoutNumberText,
} from "./joints";

const empty = emptyState("ws://here");
const urdf = `<robot><joint name="a" type="revolute"><limit effort="1" lower="-1" upper="1"/></joint>
<joint name='gripper' type='revolute'><limit lower='0' upper='1.5'/></joint>
<joint name="fixed" type="fixed"><parent link="x"/></joint></robot>`;
const limits: Record<string, [number, number]> = { a: [-0.5, 2], gripper: [-1, 1] };

test("limits are those of the server within those of the description", () => {
  expect(jointLimits({ limits, urdf })).toEqual({ a: [-0.5, 1], gripper: [0, 1] });
  expect(jointLimits({ limits: {}, urdf })).toEqual({ a: [-1, 1], gripper: [0, 1.5] });
  expect(jointLimits({ limits: { a: [3, 4] }, urdf })).toEqual({ a: [3, 4] });
});

test("joints of the arm are those of the named states, or all but the gripper", () => {
  const named = { home: { saved: false, joints: { gripper: 0 } } };
  expect(armJoints({ ...empty, limits })).toEqual(["a"]);
  expect(gripperJoint({ ...empty, limits })).toBe("gripper");
  expect(armJoints({ ...empty, limits, named })).toEqual(["gripper"]);
  expect(gripperJoint({ ...empty, limits: { a: [0, 1] } })).toBeNull();
});

test("a row shows the selection, else where the joint is, and nothing for what is no number", () => {
  const joints = { ...empty.joints, names: ["a", "b", "c"], position_rad: [1, Number.NaN, 3] };
  expect(currentPositions({ joints })).toEqual({ a: 1, c: 3 });
  const selection = { kind: "joints" as const, joints_rad: { a: 2 } };
  expect(displayedPositions({ ...empty, joints, selection })).toEqual({ a: 2, c: 3 });
  expect(displayedPositions({ ...empty, joints })).toEqual({ a: 1, c: 3 });
});

const KNOWN = new Set(["pan", "lift"]);

function joints(names: string[], position_rad: number[]) {
  return { names, position_rad, velocity: [], effort: [], stamp: 0 };
}

describe("jointReport", () => {
  it("takes finite positions of known joints", () => {
    const report = jointReport(joints(["lift", "pan"], [0.5, -1]), KNOWN);
    expect(report).toEqual({ values: { lift: 0.5, pan: -1 }, unknown: [], without_number: [] });
    expect(unknownNamesText(report, KNOWN)).toBe("");
    expect(withoutNumberText(report)).toBe("");
  });
  it("leaves out what is no number, and says so", () => {
    const report = jointReport(joints(["pan", "lift"], [Number.NaN]), KNOWN);
    expect(report.values).toEqual({});
    expect(withoutNumberText(report)).toContain("pan, lift");
    expect(jointReport(joints(["pan"], [Infinity]), KNOWN).without_number).toEqual(["pan"]);
  });
  it("names what the robot does not have", () => {
    const report = jointReport(joints(["elbow"], [1]), KNOWN);
    expect(unknownNamesText(report, KNOWN)).toContain("elbow");
    expect(unknownNamesText(report, KNOWN)).toContain("pan, lift");
  });
});

describe("looksEqual", () => {
  const pan = joints(["pan", "lift"], [0.5, -1]);
  it("overlooks what cannot be seen", () => {
    expect(looksEqual(pan, joints(["pan", "lift"], [0.50001, -1]))).toBe(true);
    expect(looksEqual(joints(["pan"], [Number.NaN]), joints(["pan"], [Number.NaN]))).toBe(true);
  });
  it.each([
    ["a motion", joints(["pan", "lift"], [0.502, -1])],
    ["other names", joints(["pan", "roll"], [0.5, -1])],
    ["fewer joints", joints(["pan"], [0.5])],
    ["a number that is none", joints(["pan", "lift"], [Number.NaN, -1])],
  ])("sees %s", (_, other) => {
    expect(looksEqual(pan, other)).toBe(false);
    expect(looksEqual(other, pan)).toBe(false);
  });
});
