import { describe, expect, it, test } from "vitest";
import { robotOf, TWO_ARMS } from "./robots.test.data";
import { emptyState } from "../state/state";
import {
  armGripper,
  armJoints,
  armNamespace,
  currentPositions,
  displayedPositions,
  groupPoses,
  isOneArm,
  jointKind,
  jointReport,
  looksEqual,
  shownPosition,
  unknownNamesText,
  withoutNumberText,
} from "./joints";

const empty = emptyState("ws://here");
const limits: Record<string, [number, number]> = { a: [-0.5, 2], claw: [-1, 1], wheel: [-9, 9] };
const gripper = { joints: ["claw"], open: 1, closed: 0, action: "/gripper_controller/gripper_cmd" };
const robot = { ...robotOf({ name: "arm", joints: ["a", "wheel"], gripper }), joints: { wheel: "continuous" as const } };

test("joints of the arm are those of the group, or all that are driven before it is known", () => {
  expect(armJoints({ ...empty, limits })).toEqual(["a", "claw", "wheel"]);
  expect(armJoints({ ...empty, limits, robot })).toEqual(["a", "wheel"]);
});

test("gripper, namespace and kinds of joints are those that the server tells", () => {
  expect([armGripper({ ...empty, robot }), armGripper(empty)]).toEqual([gripper, null]);
  const both = { ...empty, robot: TWO_ARMS, group: "both_arms" };
  expect([armNamespace({ ...both, group: "right_arm" }), armNamespace(both), armNamespace(empty)]).toEqual(["/right", "", ""]);
  expect([isOneArm({ ...both, group: "right_arm" }), isOneArm(both), isOneArm(empty)]).toEqual([true, false, true]);
  expect([jointKind({ robot }, "wheel"), jointKind({ robot: null }, "wheel")]).toEqual(["continuous", "revolute"]);
});

test("a saved pose says something of all joints, of which the group takes its own", () => {
  const named = { aside: { saved: true, joints: { a: 1, claw: 2 } }, grip: { saved: true, joints: { claw: 2 } } };
  const poses = { aside: { saved: true, joints: { a: 1 } } };
  expect(groupPoses({ ...empty, limits, robot, named })).toEqual(poses);
});

test("described poses are those of the group's joints", () => {
  const pose = (joints: Record<string, number>) => ({ saved: false, joints });
  const named = { home: pose({ a: 0, wheel: 0 }), part: pose({ a: 1 }), open: pose({ claw: 1 }), all: pose({ a: 0, claw: 0 }) };
  expect(Object.keys(groupPoses({ ...empty, limits, robot, named }))).toEqual(["home", "part"]);
});

test("a continuous joint is shown within half a turn of zero, other joints as they are", () => {
  expect(shownPosition(7, "continuous")).toBeCloseTo(7 - 2 * Math.PI, 12);
  expect(shownPosition(-3, "continuous")).toBe(-3);
  expect(shownPosition(7, "revolute")).toBe(7);
  expect(shownPosition(Number.NaN, "continuous")).toBeNaN();
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
