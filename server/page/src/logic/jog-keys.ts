import { TIP_AXES, type JogCommand, type TipAxis } from "./jog";

/** Pair of keys: the first raises, the second lowers. */
export type KeyPair = readonly [string, string];

/** Keys of the tip's axes: the arrows in the plane, then a key of the middle row above one of the lower row. */
const TIP_KEYS: Record<TipAxis, KeyPair> = {
  x: ["ArrowUp", "ArrowDown"],
  y: ["ArrowLeft", "ArrowRight"],
  z: ["KeyA", "KeyZ"],
  roll: ["KeyS", "KeyX"],
  pitch: ["KeyD", "KeyC"],
  yaw: ["KeyF", "KeyV"],
};

/** Keys that open and close the gripper. */
export const GRIPPER_KEYS: KeyPair = ["KeyG", "KeyB"];

/** Keys of the joints in their order: a digit raises the joint, the key below it lowers it. */
const UP = [..."1234567890"].map((digit) => `Digit${digit}`).concat("Minus", "Equal");
const DOWN = [..."QWERTYUIOP"].map((letter) => `Key${letter}`).concat("BracketLeft", "BracketRight");

/** Keys without a digit or letter, as an English keyboard prints them. */
const PRINTED: Record<string, string> = {
  Minus: "-",
  Equal: "=",
  BracketLeft: "[",
  BracketRight: "]",
  ArrowUp: "↑",
  ArrowDown: "↓",
  ArrowLeft: "←",
  ArrowRight: "→",
};

/** Return a key as it is printed on the keyboard. */
export function printedKey(code: string): string {
  return PRINTED[code] ?? code.slice(-1);
}

export function tipKeys(axis: TipAxis): KeyPair {
  return TIP_KEYS[axis];
}

/** Return the keys of a joint by its index; null for a joint without. */
export function jointKeys(index: number): KeyPair | null {
  const [up, down] = [UP[index], DOWN[index]];
  return up === undefined || down === undefined ? null : [up, down];
}

/** Return the command of a key at full speed; null for a key without one. */
export function keyCommand(code: string, axes: readonly TipAxis[], joints: readonly string[]): JogCommand | null {
  const sign = (pair: KeyPair | null): number => (pair?.[0] === code ? 1 : pair?.[1] === code ? -1 : 0);
  if (sign(GRIPPER_KEYS) !== 0) return { kind: "gripper", velocity: { opening: sign(GRIPPER_KEYS) } };
  const axis = TIP_AXES.find((each) => axes.includes(each) && sign(tipKeys(each)) !== 0);
  if (axis) return { kind: "tip", velocity: { [axis]: sign(tipKeys(axis)) } };
  const index = joints.findIndex((_, each) => sign(jointKeys(each)) !== 0);
  const joint = joints[index];
  return joint === undefined ? null : { kind: "joints", velocity: { [joint]: sign(jointKeys(index)) } };
}
