import { Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import { headingOf, motionBetween, poseOfDevice, poseOfViewer, type PhonePose } from "./phone-pose";

const STRAIGHT = { x: 0, y: 0, z: 0, w: 1 };

function device(alpha: number, beta: number, gamma: number, screen_deg = 0): PhonePose {
  const pose = poseOfDevice({ alpha, beta, gamma }, screen_deg);
  if (pose === null) throw new Error("no pose");
  return pose;
}

test("a device without sensors has no pose", () => {
  expect(poseOfDevice({ alpha: null, beta: null, gamma: null }, 0)).toBeNull();
});

test("a phone that lies flat with its top to the north has the axes of the earth", () => {
  expect(device(0, 0, 0).orientation.angleTo(new Quaternion())).toBeCloseTo(0);
});

test("a phone that is turned with its page stays the same to whoever holds it", () => {
  // Upright in landscape: the screen's angle is 90, and what is up for the page is up.
  const up = new Vector3(0, 1, 0).applyQuaternion(device(0, 0, -90, 90).orientation);
  expect(up.z).toBeCloseTo(1);
});

test.each([
  ["flat", device(0, 0, 0), Math.PI / 2],
  ["flat and turned to the left", device(90, 0, 0), Math.PI],
  ["upright", device(0, 90, 0), Math.PI / 2],
])("the heading of a phone that is %s is where its user looks", (_, pose, yaw_rad) => {
  const ahead = new Vector3(1, 0, 0).applyQuaternion(headingOf(pose));
  expect(Math.abs(Math.atan2(ahead.y, ahead.x))).toBeCloseTo(yaw_rad);
});

test.each([
  ["forward", { x: 0, y: 0, z: -0.1 }, [0.1, 0, 0]],
  ["to the right", { x: 0.1, y: 0, z: 0 }, [0, -0.1, 0]],
  ["up", { x: 0, y: 0.1, z: 0 }, [0, 0, 0.1]],
])("a viewer of WebXR that goes %s does so to whoever holds it", (_, position, expected) => {
  const first = poseOfViewer({ x: 0, y: 0, z: 0 }, STRAIGHT);
  const { linear_m } = motionBetween(first, poseOfViewer(position, STRAIGHT), headingOf(first));
  linear_m.toArray().forEach((value, index) => expect(value).toBeCloseTo(expected[index] ?? 0));
});

test("forward is where the phone looked at first, not the north", () => {
  // Turned by a quarter to the left: the phone looks along -x of WebXR's frame.
  const left = { x: 0, y: Math.SQRT1_2, z: 0, w: Math.SQRT1_2 };
  const first = poseOfViewer({ x: 0, y: 0, z: 0 }, left);
  const { linear_m } = motionBetween(first, poseOfViewer({ x: -0.1, y: 0, z: 0 }, left), headingOf(first));
  expect(linear_m.x).toBeCloseTo(0.1);
});

test("without positions a phone only turns", () => {
  const { linear_m, angular_rad } = motionBetween(device(0, 90, 0), device(10, 90, 0), headingOf(device(0, 90, 0)));
  expect(linear_m.length()).toBe(0);
  expect(angular_rad.z).toBeCloseTo((10 * Math.PI) / 180);
});

test("a turn takes the shorter way", () => {
  const first = device(5, 90, 0);
  const { angular_rad } = motionBetween(first, device(355, 90, 0), headingOf(first));
  expect(angular_rad.z).toBeCloseTo((-10 * Math.PI) / 180);
});
