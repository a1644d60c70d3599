import { expect, it } from "vitest";
import {
  asWaypoints,
  edited,
  legRequest,
  MAX_WAYPOINTS,
  moved,
  newWaypoint,
  readSequence,
  sequenceSteps,
  sequenceText,
  taughtWaypoint,
  type Waypoint,
} from "./sequence";
import { sequenceProgram } from "./sequence-program";

const FIRST = newWaypoint([], "arm", { pan: 0.1234567, lift: -0.5 }, 0.3);
const SECOND: Waypoint = { ...newWaypoint([FIRST], "arm", { pan: 0.2, lift: 0 }, 1), straight: true, gripper: 0.5, pause_s: 2 };
const THIRD = newWaypoint([FIRST, SECOND], "arm", { pan: 0, lift: 0 }, 0.3);
const ALL = [FIRST, SECOND, THIRD];

const ids = (waypoints: Waypoint[]): number[] => waypoints.map(({ id }) => id);

it("numbers waypoints and rounds their joints", () => {
  expect(ids(ALL)).toEqual([1, 2, 3]);
  expect(FIRST.joints_rad).toEqual({ pan: 0.12346, lift: -0.5 });
});

it.each([
  [1, 1, [2, 1, 3]],
  [3, 0, [3, 1, 2]],
  [2, 9, [1, 3, 2]],
  [1, -1, [1, 2, 3]],
])("moves waypoint %i to index %i", (id, index, expected) => expect(ids(moved(ALL, id, index))).toEqual(expected));

it("edits one waypoint and leaves the others as they are", () => {
  const changed = edited(ALL, 2, { speed: 0.5 });
  expect(changed[1]).toEqual({ ...SECOND, speed: 0.5 });
  expect(changed[0]).toBe(FIRST);
});

it("asks for a straight leg by Pilz's LIN, from the start that is given", () => {
  expect(legRequest(SECOND, { pan: 1 })).toMatchObject({
    group_name: "arm",
    planner_id: "LIN",
    max_velocity_scaling_factor: 1,
    start_state: { joint_state: { name: ["pan"], position: [1] } },
  });
  expect(legRequest(FIRST)).not.toHaveProperty("planner_id");
  expect(legRequest(FIRST)).not.toHaveProperty("start_state");
});

it("moves, grips and waits, in this order", () => {
  expect(sequenceSteps(ALL, "/grip").map(({ doing, index }) => [doing, index])).toEqual([
    ["motion", 0],
    ["motion", 1],
    ["gripper", 1],
    ["pause", 1],
    ["motion", 2],
  ]);
});

it("leaves out the gripper of an arm that has none", () => {
  expect(sequenceSteps(ALL, null).map(({ doing }) => doing)).toEqual(["motion", "motion", "pause", "motion"]);
});

it("reads what it has written", () => expect(readSequence(sequenceText(ALL))).toEqual(ALL));

it.each([
  ["no JSON", "{"],
  ["no list", "{}"],
  ["no joints", '{"waypoints": [{}]}'],
  ["a joint without a number", '{"waypoints": [{"joints_rad": {"pan": "far"}}]}'],
  ["a speed of 0", '{"waypoints": [{"joints_rad": {"pan": 1}, "speed": 0}]}'],
  ["a negative pause", '{"waypoints": [{"joints_rad": {"pan": 1}, "pause_s": -1}]}'],
  ["an entry that is null", '{"waypoints": [null]}'],
  ["too many waypoints", JSON.stringify({ waypoints: Array.from({ length: MAX_WAYPOINTS + 1 }, () => FIRST) })],
])("reads nothing from %s", (_, text) => expect(readSequence(text)).toBeNull());

it("writes values as Python does, and names with quotes as texts", () => {
  const { file, text } = sequenceProgram("python", [{ ...SECOND, name: 'a "b"\n' }, FIRST], "ws://host:1/", "/grip");
  expect(file).toBe("sequence.py");
  expect(text).toContain('{"name": "a \\"b\\"\\n", "group": "arm", "joints_rad": {"pan": 0.2, "lift": 0}, "motion": None, "straight": True,');
  expect(text).toContain('"gripper": None');
  expect(text).toContain('else "ws://host:1/"');
  expect(text).not.toMatch(/<<|>>|true|null/);
});

it("writes values as JavaScript does", () => {
  const { file, text } = sequenceProgram("javascript", [FIRST], "ws://host:1/", null);
  expect(file).toBe("sequence.mjs");
  expect(text).toContain("const GRIPPER_ACTION = null;");
  expect(text).toContain('"straight":false');
});

const TAUGHT = {
  names: ["pan", "grip", "lift"],
  points: [
    { time_s: 0, position_rad: [0, 0.5, 0] },
    { time_s: 1, position_rad: [0.5, 0.5, 0] },
    { time_s: 2, position_rad: [0.5, 0.1, 1] },
  ],
};

it("replays a taught motion as one row, from its start to its end", () => {
  const row = taughtWaypoint(ALL, "arm", "wave", TAUGHT, ["pan", "lift"]);
  expect(row).toMatchObject({ id: 4, name: "wave", joints_rad: { pan: 0.5, lift: 1 }, motion: { name: "wave", start_rad: { pan: 0, lift: 0 } } });
  expect(sequenceSteps([{ ...row, speed: 0.5 }], null)).toEqual([
    {
      doing: "motion",
      index: 0,
      action: "/replay_motion",
      type: "armbridge_msgs/action/ReplayMotion",
      goal: { name: "wave", speed: 0.5, reverse: false, repeat: 0 },
    },
  ]);
  expect(readSequence(sequenceText([row]))).toEqual([{ ...row, id: 1 }]);
});

it("makes a taught motion waypoints, which move the gripper where it was moved", () => {
  const rows = asWaypoints([FIRST], "arm", "wave", TAUGHT, ["pan", "lift"], "grip", 0.3);
  expect(rows.map(({ id, name, joints_rad, gripper, motion, speed }) => [id, name, joints_rad, gripper, motion, speed])).toEqual([
    [2, "wave 1", { pan: 0, lift: 0 }, 0.5, null, 0.3],
    [3, "wave 2", { pan: 0.5, lift: 0 }, null, null, 0.3],
    [4, "wave 3", { pan: 0.5, lift: 1 }, 0.1, null, 0.3],
  ]);
});

it("refuses a file whose taught motion has no start", () => {
  const row = taughtWaypoint([], "arm", "wave", TAUGHT, ["pan"]);
  const text = JSON.stringify({ waypoints: [{ ...row, motion: { name: "wave" } }] });
  expect(readSequence(text)).toBeNull();
});
