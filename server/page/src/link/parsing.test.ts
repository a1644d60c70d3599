import { expect, test } from "vitest";
import * as parsing from "./parsing";
import type { DiagnosticStatus } from "./wire";

const stamp = { sec: 12, nanosec: 500_000_000 };

function status(values: Record<string, string>, patch: Partial<DiagnosticStatus> = {}): DiagnosticStatus {
  const pairs = Object.entries(values).map(([key, value]) => ({ key, value }));
  return { level: 0, name: "arm", message: "well", hardware_id: "so101", values: pairs, ...patch };
}

test("joints without a position, and numbers that JSON has no word for, are not numbers", () => {
  const read = parsing.joints({ header: { stamp }, name: ["a", "b", "c"], position: [1, null], velocity: [], effort: [] });
  expect(read).toMatchObject({ names: ["a", "b", "c"], position_rad: [1, Number.NaN, Number.NaN], stamp: 12.5 });
});

test("values by name leave out what is no number", () => {
  expect(parsing.byName(["a", "b", "c"], [1, null])).toEqual({ a: 1 });
});

test("the arm's state has fault and remedy", () => {
  const arm = parsing.arm(status({ mode: "fault", fault: "overload", fault_remedy: "Lift it.", speed_factor: "0.5" }));
  expect(arm).toMatchObject({ mode: "fault", fault: "overload", fault_remedy: "Lift it.", speed_factor: 0.5 });
  expect(parsing.arm(status({})).mode).toBe("disconnected");
});

test("a refused goal has its code, its sentence and what would work", () => {
  const suggested = { topic: "/moveit_goal_named", type: "std_msgs/String", msg: { data: "home" } };
  const values = { state: "done", code: "-16", suggested_goal: JSON.stringify(suggested) };
  const goal = parsing.goal(status(values, { hardware_id: "7", message: "no such name" }));
  expect(goal).toMatchObject({ id: "7", code: -16, message: "no such name", suggestion: suggested });
});

test("a suggestion that cannot be read is none", () => {
  expect(parsing.goal(status({ state: "done", suggested_goal: "{" })).suggestion).toBeNull();
  expect(parsing.goal(status({ state: "done", suggested_goal: "[]" })).suggestion).toBeNull();
});

test("only the servos are listed, by joint", () => {
  const found = parsing.servos([
    status({}),
    status({ temperature_c: "33" }, { name: "arm: elbow_flex", hardware_id: "servo 3" }),
  ]);
  expect(found).toEqual([{ name: "elbow_flex", level: 0, message: "well", values: { temperature_c: "33" } }]);
});

test("a plan has times in seconds, and one without points is none", () => {
  const point = { positions: [0.1], time_from_start: stamp };
  const joint_trajectory = { joint_names: ["a"], points: [point] };
  expect(parsing.plan({ joint_trajectory })).toEqual({ names: ["a"], points: [{ time_s: 12.5, position_rad: [0.1] }] });
  expect(parsing.plan({ joint_trajectory: { joint_names: [], points: [] } })).toBeNull();
});

test("named states that cannot be read are none", () => {
  expect(parsing.named("{")).toEqual({});
});

test("nobody drives, and nothing is left to wait for, where the server says so", () => {
  const free = status({ holder: "", address: "", policy: "shared", free_in_s: "" }, { hardware_id: "" });
  expect(parsing.control(free)).toEqual({ holder: "", address: "", policy: "shared", free_in_s: null });
});

test("an identity that cannot be read is none", () => {
  for (const text of ["{", "null", '{"address": 1, "role": "view"}', '{"address": "a", "role": "king"}']) {
    expect(parsing.identity(text)).toBeNull();
  }
  expect(parsing.identity('{"address": "a", "role": "view", "name": "x"}')).toEqual({ address: "a", role: "view" });
});
