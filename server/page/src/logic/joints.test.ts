import { describe, expect, it, test } from "vitest";
import { emptyState } from "../state/state";
import {
  armGripper,
  armJoints,
  armName,
  currentPositions,
  displayedPositions,
  gripperAction,
  groupPoses,
  jointLimits,
  jointReport,
  looksEqual,
  shownPosition,
  unknownNamesText,
  withoutNumberText,
} from "./joints";

const empty = emptyState("ws://here");
const urdf = `<robot><joint name="a" type="revolute"><limit effort="1" lower="-1" upper="1"/></joint>
<joint name='claw' type='revolute'><limit lower='0' upper='1.5'/></joint>
<joint name="wheel" type="continuous"/>
<joint name="fixed" type="fixed"><parent link="x"/></joint></robot>`;
const srdf = '<robot><group name="arm"><joint name="a"/><joint name="wheel"/></group></robot>';
const limits: Record<string, [number, number]> = { a: [-0.5, 2], claw: [-1, 1], wheel: [-9, 9] };
const TURN = [-Math.PI, Math.PI];

test("limits are those of the server within those of the description", () => {
  expect(jointLimits({ limits, urdf, srdf: null })).toEqual({ a: [-0.5, 1], claw: [0, 1], wheel: TURN });
  expect(jointLimits({ limits: {}, urdf, srdf: null })).toEqual({ a: [-1, 1], claw: [0, 1.5], wheel: TURN });
  expect(jointLimits({ limits: { a: [3, 4] }, urdf, srdf: null })).toEqual({ a: [3, 4] });
});

test("joints of the arm are those of the group that the server drives, or all", () => {
  expect(armJoints({ ...empty, limits })).toEqual(["a", "claw", "wheel"]);
  expect(armJoints({ ...empty, limits, urdf, srdf })).toEqual(["a", "wheel"]);
  expect(armJoints({ ...empty, limits: { a: [0, 1] }, urdf, srdf })).toEqual(["a"]);
});

test("a gripper of no group is the joints of no group, and there is none where all have one", () => {
  const gripper = { group: "", joints: ["claw"], open: 1, closed: 0 };
  expect(armGripper({ ...empty, limits, urdf, srdf })).toEqual(gripper);
  expect(armGripper({ ...empty, limits, urdf })).toBeNull();
  expect(armGripper({ ...empty, limits: { a: [0, 1] }, urdf, srdf })).toBeNull();
});

test("a gripper that the server offers no action for is not shown", () => {
  expect(armGripper({ ...empty, limits, urdf, srdf, actions: [] })).toBeNull();
  expect(armGripper({ ...empty, limits, urdf, srdf, actions: ["/gripper_controller/gripper_action"] })).not.toBeNull();
});

test("a gripper is moved by its own controller, else by that of the only gripper", () => {
  const gripper = { group: "left_hand", joints: ["claw"], open: 1, closed: 0 };
  const own = "/left_hand_controller/gripper_cmd";
  expect(gripperAction(gripper, ["/gripper_controller/gripper_cmd", own])).toBe(own);
  expect(gripperAction(gripper, ["/gripper_controller/gripper_cmd"])).toBe("/gripper_controller/gripper_cmd");
  expect(gripperAction(gripper, null)).toBe("/gripper_controller/gripper_cmd");
  expect(gripperAction(gripper, ["/other"])).toBeNull();
});

test("an arm among several is that of whose name all joints begin with", () => {
  const actions = ["/left/moveit_goal", "/left_hand/moveit_goal", "/execute_trajectory"];
  expect(armName(["left_a", "left_b"], actions)).toBe("left");
  expect(armName(["left_hand_a"], actions)).toBe("left_hand");
  expect(armName(["left_a", "right_a"], actions)).toBe("");
  expect(armName(["left_a"], ["/moveit_goal"])).toBe("");
  expect(armName([], actions)).toBe("");
  expect(armName(["left_a"], null)).toBe("");
});

test("the gripper of one of several arms is moved below the arm's name", () => {
  const gripper = { group: "left_gripper", joints: ["left_claw"], open: 1, closed: 0 };
  const own = "/left/gripper_controller/gripper_cmd";
  expect(gripperAction(gripper, ["/gripper_controller/gripper_cmd", "/left/moveit_goal", own])).toBe(own);
});

test("a saved pose says something of all joints, of which the group takes its own", () => {
  const named = { aside: { saved: true, joints: { a: 1, claw: 2 } }, grip: { saved: true, joints: { claw: 2 } } };
  const poses = { aside: { saved: true, joints: { a: 1 } } };
  expect(groupPoses({ ...empty, limits, urdf, srdf, named })).toEqual(poses);
});

test("described poses are those of the group's joints", () => {
  const pose = (joints: Record<string, number>) => ({ saved: false, joints });
  const named = { home: pose({ a: 0, wheel: 0 }), part: pose({ a: 1 }), open: pose({ claw: 1 }), all: pose({ a: 0, claw: 0 }) };
  expect(Object.keys(groupPoses({ ...empty, limits, urdf, srdf, named }))).toEqual(["home", "part"]);
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
