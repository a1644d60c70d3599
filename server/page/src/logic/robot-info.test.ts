import { expect, test } from "vitest";
import { planningGroup, type RobotInfo } from "./robot-info";
import { robotOf } from "./robots.test.data";

const ROBOT = robotOf({ name: "whole" }, { name: "upper" });
const chosen = (group: string, robot: RobotInfo | null = ROBOT): string | undefined => planningGroup({ robot, group })?.name;

test("the selected group counts, else the default, else the first", () => {
  expect(chosen("upper")).toBe("upper");
  expect(chosen("gone")).toBe("whole");
  expect(chosen("", { ...ROBOT, default_group: "gone" })).toBe("whole");
  expect(chosen("", null)).toBeUndefined();
});
