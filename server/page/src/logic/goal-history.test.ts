import { describe, expect, it, test } from "vitest";
import { NO_GOAL } from "../state/state";
import { fromServer, goalKind, joinedPlan, MAX_GOALS, readAsked, withStatus, type GoalEntry } from "./goal-history";

const goal = (id: string, state: string, source = "/moveit_goal_named"): GoalEntry["goal"] => ({ ...NO_GOAL, id, state, source });

describe("the history", () => {
  it("has one entry for all statuses of a goal, with the time of the first", () => {
    const history = withStatus(withStatus([], goal("1", "planning"), 10), goal("1", "done"), 12);
    expect(history).toEqual([{ goal: goal("1", "done"), began_s: 10, stamp_s: 12 }]);
  });

  it("takes a goal with the number of one that is done for a goal of a new server", () => {
    const history = withStatus(withStatus([], goal("1", "done"), 10), goal("1", "planning"), 20);
    expect(history).toEqual([{ goal: goal("1", "planning"), began_s: 20, stamp_s: 20 }]);
  });

  it("is bounded", () => {
    let history: GoalEntry[] = [];
    for (let id = 0; id < MAX_GOALS + 5; id += 1) history = withStatus(history, goal(String(id), "done"), id);
    expect([history.length, history[0]?.goal.id]).toEqual([MAX_GOALS, "5"]);
  });

  it("is the server's after a connection, with goals that are still in progress", () => {
    const told = [{ goal: goal("1", "done"), began_s: 12, stamp_s: 12 }];
    const own = [
      { goal: goal("1", "done"), began_s: 10, stamp_s: 12 },
      { goal: goal("9", "done"), began_s: 1, stamp_s: 2 },
      { goal: goal("2", "executing"), began_s: 13, stamp_s: 14 },
    ];
    expect(fromServer(told, own).map(({ goal: { id }, began_s }) => [id, began_s])).toEqual([["1", 10], ["2", 13]]);
  });
});

test.each([
  ["/moveit_goal_named", "named"],
  ["/move_action", "move"],
  ["/arm_controller/follow_joint_trajectory", "trajectory"],
  ["/else", "other"],
])("%s is of the kind %s", (source, kind) => expect(goalKind(source)).toBe(kind));

const ARM = {
  robot: { joints: { rail: "prismatic" as const }, default_group: "", groups: [], reach_m: 1 },
  settings: { units: "deg" as const, speed: 1 },
};

test.each([
  ["a name", { data: "ready" }, { kind: "named", name: "ready" }],
  ["joints", { name: ["a", "b"], position: [Math.PI / 2, -1] }, { kind: "joints", text: "a 90.0°, b -57.3°" }],
  ["a joint that slides", { name: ["rail"], position: [0.5] }, { kind: "joints", text: "rail 500.0 mm" }],
  ["a pose", { pose: { position: { x: 0.1, y: 0, z: 2 } } }, { kind: "point", point: ["100.0", "0.0", "2000.0"], unit: "mm" }],
  [
    "joints of MoveGroup",
    { request: { goal_constraints: [{ joint_constraints: [{ joint_name: "a", position: 0 }], position_constraints: [] }] } },
    { kind: "joints", text: "a 0.0°" },
  ],
  [
    "a point of MoveGroup",
    { request: { goal_constraints: [{ position_constraints: [{ constraint_region: { primitive_poses: [{ position: { x: 1, y: 2, z: 3 } }] } }] }] } },
    { kind: "point", point: ["1000.0", "2000.0", "3000.0"], unit: "mm" },
  ],
  ["something else", { trajectory: {} }, null],
])("%s is read", (_, message, asked) => expect(readAsked(JSON.stringify(message), ARM)).toEqual(asked));

test("a message that was cut off is not read", () => expect(readAsked('{"data": "rea', ARM)).toBeNull());

test("plans are joined, and joints of one alone keep their place", () => {
  const first = { names: ["a"], points: [{ time_s: 0, position_rad: [0] }, { time_s: 2, position_rad: [1] }] };
  const second = { names: ["b"], points: [{ time_s: 0, position_rad: [5] }, { time_s: 1, position_rad: [6] }] };
  expect(joinedPlan([first, second])).toEqual({
    names: ["a", "b"],
    points: [
      { time_s: 0, position_rad: [0, 5] },
      { time_s: 2, position_rad: [1, 5] },
      { time_s: 2, position_rad: [1, 5] },
      { time_s: 3, position_rad: [1, 6] },
    ],
  });
});
