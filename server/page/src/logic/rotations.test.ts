import { expect, test } from "vitest";
import type { Orientation } from "../state/state";
import { quaternionOf, rollPitchYawOf, type RollPitchYaw } from "./rotations";

/** Angle between two rotations [rad]. */
function angle(one: Orientation, other: Orientation): number {
  const product = one.reduce((sum, value, index) => sum + value * (other[index] ?? 0), 0);
  return 2 * Math.acos(Math.min(1, Math.abs(product)));
}

test("roll, pitch and yaw turn about x, y and z, and yaw comes last", () => {
  const half = Math.SQRT1_2;
  expect(quaternionOf([Math.PI / 2, 0, 0])).toEqual([expect.closeTo(half), 0, 0, expect.closeTo(half)]);
  expect(quaternionOf([0, Math.PI / 2, 0])).toEqual([0, expect.closeTo(half), 0, expect.closeTo(half)]);
  // x goes to y by the yaw, whatever was before it.
  expect(quaternionOf([Math.PI / 2, 0, Math.PI / 2])).toEqual([0.5, 0.5, 0.5, 0.5].map((value) => expect.closeTo(value)));
});

const ANGLES = [-3, -1.2, 0, 0.4, 2.9];

test.each(ANGLES)("there and back is the same rotation, roll %d", (roll) => {
  for (const pitch of [-Math.PI / 2, -1.5, 0, 0.7, Math.PI / 2]) {
    for (const yaw of ANGLES) {
      const rotation = quaternionOf([roll, pitch, yaw]);
      expect(angle(quaternionOf(rollPitchYawOf(rotation)), rotation)).toBeLessThan(1e-4);
    }
  }
});

test("away from the poles the three angles come back as they were", () => {
  const typed: RollPitchYaw = [0.3, -1.1, 2.5];
  expect(rollPitchYawOf(quaternionOf(typed))).toEqual(typed.map((value) => expect.closeTo(value, 9)));
});
