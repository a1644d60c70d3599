import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import {
  goalConstraints,
  jointConstraints,
  jointJog,
  moveGroupGoal,
  positionConstraints,
  readArmState,
  readControl,
  readGoal,
  readJoints,
  readLimits,
  readPlan,
  readServos,
  valuesByJoint,
  type DiagnosticStatus,
} from "./messages";

const empty = emptyState("ws://here");

test("without a selection nothing is asked for", () => {
  expect(goalConstraints(empty)).toBeNull();
});

test("a selection for joints or a named state is a goal for exactly these joints", () => {
  const selection = { kind: "named" as const, joints_rad: { elbow_flex: 0.5 } };
  expect(goalConstraints({ ...empty, selection })).toEqual({
    joint_constraints: [
      { joint_name: "elbow_flex", position: 0.5, tolerance_above: 1e-4, tolerance_below: 1e-4, weight: 1 },
    ],
  });
});

test("a target that can be reached is asked for as the ghost shows it, any other as a point", () => {
  const selection = { kind: "target" as const, joints_rad: null };
  const target = { ...empty.target, position_m: [0.3, 0, 0.2] as [number, number, number], joints_rad: { a: 1 } };
  expect(goalConstraints({ selection, target: { ...target, reachable: true } })).toEqual(jointConstraints({ a: 1 }));
  expect(goalConstraints({ selection, target: { ...target, reachable: false } })).toEqual(positionConstraints([0.3, 0, 0.2], 0.01));
  expect(goalConstraints({ selection, target: { ...target, reachable: null } })).toEqual(positionConstraints([0.3, 0, 0.2], 0.01));
});

test("a pose that cannot be reached is asked for with its orientation", () => {
  const selection = { kind: "target" as const, joints_rad: null };
  const target = { ...empty.target, position_m: [0.3, 0, 0.2] as [number, number, number], reachable: false };
  const constraints = goalConstraints({ selection, target: { ...target, orientation: [0, 1, 0, 0] } });
  expect(constraints).toMatchObject({
    ...positionConstraints([0.3, 0, 0.2], 0.01),
    orientation_constraints: [{ orientation: { x: 0, y: 1, z: 0, w: 0 }, link_name: "" }],
  });
});

test("a goal is for the selected group", () => {
  expect(moveGroupGoal({}, 0.4, true, "left")).toMatchObject({ request: { group_name: "left" } });
});

test("a joint without limits goes through a whole turn", () => {
  const limit = { joint_name: "a", has_position_limits: true, min_position: -1, max_position: 2 };
  const any = { joint_name: "b", has_position_limits: false, min_position: 0, max_position: 0 };
  const endless = { joint_name: "c", has_position_limits: true, min_position: null, max_position: null };
  expect(readLimits({ joint_names: [], limits: [limit, any, endless] } as never)).toEqual({
    a: [-1, 2],
    b: [-Math.PI, Math.PI],
    c: [-Math.PI, Math.PI],
  });
});

test("the speed goes into the request, and plan_only beside it", () => {
  expect(moveGroupGoal({}, 0.4, true, "")).toMatchObject({
    request: { max_velocity_scaling_factor: 0.4, max_acceleration_scaling_factor: 0.4, group_name: "" },
    planning_options: { plan_only: true },
  });
});

test("a jog has the fields of its type", () => {
  expect(jointJog({ elbow_flex: -1 })).toMatchObject({ joint_names: ["elbow_flex"], velocities: [-1] });
});

const stamp = { sec: 12, nanosec: 500_000_000 };

function status(values: Record<string, string>, patch: Partial<DiagnosticStatus> = {}): DiagnosticStatus {
  const pairs = Object.entries(values).map(([key, value]) => ({ key, value }));
  return { level: 0, name: "arm", message: "well", hardware_id: "so101", values: pairs, ...patch };
}

test("joints without a position, and numbers that JSON has no word for, are not numbers", () => {
  const read = readJoints({ header: { stamp }, name: ["a", "b", "c"], position: [1, null], velocity: [], effort: [] } as never);
  expect(read).toMatchObject({ names: ["a", "b", "c"], position_rad: [1, Number.NaN, Number.NaN], stamp: 12.5 });
});

test("values by name leave out what is no number", () => {
  expect(valuesByJoint(["a", "b", "c"], [1, null])).toEqual({ a: 1 });
});

test("the arm's state has fault and remedy", () => {
  const arm = readArmState(status({ mode: "fault", fault: "overload", fault_remedy: "Lift it.", speed_factor: "0.5", speed_limit: "0.1" }));
  expect(arm).toMatchObject({ mode: "fault", fault: "overload", fault_remedy: "Lift it.", speed_factor: 0.5, speed_limit: 0.1 });
  expect(readArmState(status({ speed_limit: "?" }))).toMatchObject({ mode: "disconnected", speed_limit: 1 });
});

test("a refused goal has its code, its sentence and what would work", () => {
  const suggested = { topic: "/moveit_goal_named", type: "std_msgs/String", msg: { data: "home" } };
  const values = { state: "done", code: "-16", suggested_goal: JSON.stringify(suggested) };
  const goal = readGoal(status(values, { hardware_id: "7", message: "no such name" }));
  expect(goal).toMatchObject({ id: "7", code: -16, message: "no such name", suggestion: suggested });
});

test("only the servos are listed, by joint", () => {
  const found = readServos([
    status({}),
    status({ temperature_c: "33" }, { name: "arm: elbow_flex", hardware_id: "servo 3" }),
  ]);
  expect(found).toEqual([{ name: "elbow_flex", hardware: "servo 3", level: 0, message: "well", values: { temperature_c: "33" } }]);
});

test("a plan has times in seconds, and one without points is none", () => {
  const point = { positions: [0.1], time_from_start: stamp };
  const joint_trajectory = { joint_names: ["a"], points: [point] };
  expect(readPlan({ joint_trajectory } as never)).toEqual({ names: ["a"], points: [{ time_s: 12.5, position_rad: [0.1] }] });
  expect(readPlan({ joint_trajectory: { joint_names: [], points: [] } } as never)).toBeNull();
});

test("nobody drives, and nothing is left to wait for, where the server says so", () => {
  const free = status({ holder: "", address: "", policy: "shared", free_in_s: "" }, { hardware_id: "" });
  expect(readControl(free)).toEqual({ holder: "", address: "", policy: "shared", free_in_s: null });
});
