import { Quaternion, Vector3 } from "three";

/** Pose of a phone in a frame whose z axis points up; the phone's x points right, y to its top, z out of its screen. */
export interface PhonePose {
  position_m: Vector3 | null;
  orientation: Quaternion;
}

/** Motion of a phone: along and about the axes forward, left and up of whoever holds it. */
export interface PhoneMotion {
  linear_m: Vector3;
  angular_rad: Vector3;
}

const X = new Vector3(1, 0, 0);
const Y = new Vector3(0, 1, 0);
const Z = new Vector3(0, 0, 1);
const RADIANS = Math.PI / 180;

/** From the frame of WebXR, whose y axis points up, to one whose z axis does. */
const FROM_XR = new Quaternion().setFromAxisAngle(X, Math.PI / 2);

/** Angles of a deviceorientation event [deg]; null from a device without sensors. */
export interface DeviceAngles {
  alpha: number | null;
  beta: number | null;
  gamma: number | null;
}

/**
 * Return the pose of a deviceorientation event, null for one without angles.
 *
 * The angles turn about z, the new x and the new y, in this order (W3C Device Orientation and Motion, section 3.1).
 *
 * @param screen_deg - angle of the screen, by which the page is turned on the device.
 */
export function poseOfDevice({ alpha, beta, gamma }: DeviceAngles, screen_deg: number): PhonePose | null {
  if (alpha === null || beta === null || gamma === null) return null;
  const turn = (axis: Vector3, angle_deg: number): Quaternion => new Quaternion().setFromAxisAngle(axis, angle_deg * RADIANS);
  const orientation = turn(Z, alpha).multiply(turn(X, beta)).multiply(turn(Y, gamma)).multiply(turn(Z, -screen_deg));
  return { position_m: null, orientation };
}

interface Point {
  x: number;
  y: number;
  z: number;
}

/** Return the pose of a viewer of WebXR, whose axes are those of the phone as it is held. */
export function poseOfViewer(position: Point, { x, y, z, w }: Point & { w: number }): PhonePose {
  const position_m = new Vector3(position.x, position.y, position.z).applyQuaternion(FROM_XR);
  return { position_m, orientation: FROM_XR.clone().multiply(new Quaternion(x, y, z, w)) };
}

/** Least horizontal part of the direction of the camera with which it tells where the phone looks; else its top does. */
const LEAST_HORIZONTAL = 0.5;

/** Return the rotation about the vertical axis to where a phone looks: what is straight ahead becomes x. */
export function headingOf({ orientation }: PhonePose): Quaternion {
  const camera = Z.clone().negate().applyQuaternion(orientation);
  const ahead = Math.hypot(camera.x, camera.y) >= LEAST_HORIZONTAL ? camera : Y.clone().applyQuaternion(orientation);
  return new Quaternion().setFromAxisAngle(Z, Math.atan2(ahead.y, ahead.x));
}

/** Return the motion from one pose to another, as seen by whoever looks along a heading. */
export function motionBetween(from: PhonePose, to: PhonePose, heading: Quaternion): PhoneMotion {
  const inverse = heading.clone().invert();
  const known = from.position_m !== null && to.position_m !== null;
  const linear_m = known ? to.position_m!.clone().sub(from.position_m!).applyQuaternion(inverse) : new Vector3();
  const turned = to.orientation.clone().multiply(from.orientation.clone().invert());
  return { linear_m, angular_rad: rotationVector(turned).applyQuaternion(inverse) };
}

/** Return how far a phone is tilted since another pose [rad]: its top away from the user, and to the left. */
export function tiltBetween(from: PhonePose, to: PhonePose): { forward_rad: number; left_rad: number } {
  // In the axes of the phone, so that it does not matter where the user turns to meanwhile.
  const { x, y } = rotationVector(from.orientation.clone().invert().multiply(to.orientation));
  return { forward_rad: -x, left_rad: -y };
}

function rotationVector(rotation: Quaternion): Vector3 {
  // Of the two quaternions of a rotation, the one of the shorter way.
  const sign = rotation.w < 0 ? -1 : 1;
  const axis = new Vector3(rotation.x, rotation.y, rotation.z).multiplyScalar(sign);
  const sine = axis.length();
  if (sine < 1e-9) return new Vector3();
  return axis.multiplyScalar((2 * Math.atan2(sine, sign * rotation.w)) / sine);
}
