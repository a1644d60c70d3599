import { expect, test } from "vitest";
import { gripperClearance_m, HANDLE_START, handleLength_m } from "./target-marker";

test("handles begin beyond the gripper", () => {
  expect(handleLength_m(0.04, 0.4) * HANDLE_START).toBeCloseTo(0.04);
});

test("far away they stay large enough for a finger, near by they stay in the picture", () => {
  expect(handleLength_m(0.04, 2)).toBeCloseTo(0.26);
  expect(handleLength_m(0.04, 0.1)).toBeCloseTo(0.03);
});

test("the clearance is half the width of the gripper, not its length", () => {
  expect(gripperClearance_m([0.05, 0.12, 0.07])).toBeCloseTo(0.035);
  expect(gripperClearance_m([])).toBe(0);
});
