import type { JointValues } from "../state/state";

/** Axes of the tip: along x, y and z of a frame, and about them. */
export const TIP_AXES = ["x", "y", "z", "roll", "pitch", "yaw"] as const;
export type TipAxis = (typeof TIP_AXES)[number];

/** Velocities of the tip as shares of the server's scales, -1 to 1. */
export type TipVelocity = Partial<Record<TipAxis, number>>;

/** Velocities that an input asks for, as shares of the scales, -1 to 1. */
export type JogCommand =
  | { kind: "tip"; velocity: TipVelocity }
  | { kind: "joints"; velocity: JointValues }
  | { kind: "gripper"; velocity: { opening?: number } };

/** Axes in the order in which an arm gets them with each further joint: pitch before roll, as a wrist that bends does. */
const AXES_BY_JOINT: readonly TipAxis[] = ["x", "y", "z", "pitch", "roll", "yaw"];

/** Return the axes that the tip of an arm with so many joints can be moved along and about. */
export function tipAxes(joints: number): TipAxis[] {
  return TIP_AXES.filter((axis) => AXES_BY_JOINT.slice(0, joints).includes(axis));
}

export function isRotation(axis: TipAxis): boolean {
  return axis === "roll" || axis === "pitch" || axis === "yaw";
}

/** Return the sum of commands of one kind, each velocity within -1 to 1; what cancels out is left out. */
export function summed(commands: readonly JogCommand[]): Record<string, number> {
  const sum: Record<string, number> = {};
  for (const { velocity } of commands) {
    for (const [name, value] of Object.entries(velocity)) sum[name] = (sum[name] ?? 0) + value;
  }
  const limited = Object.entries(sum).map(([name, value]) => [name, Math.max(-1, Math.min(1, value))] as const);
  return Object.fromEntries(limited.filter(([, value]) => value !== 0));
}

export function scaled(command: JogCommand, factor: number): JogCommand {
  const velocity = Object.fromEntries(Object.entries(command.velocity).map(([name, value]) => [name, value * factor]));
  return { ...command, velocity } as JogCommand;
}

/** Return a deflection of a stick from the edge of its dead zone on, with finer steps around its middle. */
export function shaped(deflection: number, dead_zone: number): number {
  const beyond = (Math.min(1, Math.abs(deflection)) - dead_zone) / (1 - dead_zone);
  if (!(beyond > 0)) return 0;
  return Math.sign(deflection) * (EXPO * beyond ** 3 + (1 - EXPO) * beyond);
}

/** Share of the cube in the answer to a stick, as remote controls have it ("expo"). */
const EXPO = 0.5;

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

/** Way of the thumb from where it has landed to full speed [px]: as far as it reaches without the hand moving. */
export const PAD_REACH_PX = 60;

const THUMB_DEAD_ZONE = 0.12;

/** Axes of a pad: moved by a thumb to the right, and by one upwards, with their signs. */
export interface PadAxes {
  right: readonly [TipAxis, 1 | -1] | null;
  up: readonly [TipAxis, 1 | -1] | null;
}

export const LEFT_PAD: PadAxes = { right: ["y", -1], up: ["x", 1] };

export function rightPad(rotation: TipAxis | null): PadAxes {
  return { right: rotation && [rotation, 1], up: ["z", 1] };
}

/** Return the command of a thumb that is so far from where it has landed [px, downwards positive]. */
export function padCommand(axes: PadAxes, right_px: number, down_px: number): JogCommand {
  const velocity: Partial<Record<TipAxis, number>> = {};
  const set = (axis: PadAxes["up"], way_px: number): void => {
    const share = shaped(way_px / PAD_REACH_PX, THUMB_DEAD_ZONE);
    if (axis && share !== 0) velocity[axis[0]] = axis[1] * share;
  };
  set(axes.right, right_px);
  set(axes.up, -down_px);
  return { kind: "tip", velocity };
}

/** Parts of a Gamepad with the standard mapping (W3C Gamepad, section 5) that are read. */
export interface GamepadReading {
  axes: readonly number[];
  buttons: readonly { pressed: boolean; value: number }[];
}

/** Deflection up to which a stick counts as centred; worn sticks rest at up to 0.1. */
const STICK_DEAD_ZONE = 0.15;

const BUTTONS = { close: 0, open: 1, left_shoulder: 4, right_shoulder: 5, left_trigger: 6, right_trigger: 7, left: 14, right: 15 };

/** Return true while a dead-man button, either shoulder button, is held. */
export function isDeadManHeld({ buttons }: GamepadReading): boolean {
  return [BUTTONS.left_shoulder, BUTTONS.right_shoulder].some((index) => buttons[index]?.pressed === true);
}

/** Return the commands of a gamepad; none while neither dead-man button is held. */
export function gamepadCommands(pad: GamepadReading, axes: readonly TipAxis[]): JogCommand[] {
  if (!isDeadManHeld(pad)) return [];
  const stick = (index: number): number => shaped(pad.axes[index] ?? 0, STICK_DEAD_ZONE);
  const value = (index: number): number => shaped(pad.buttons[index]?.value ?? 0, STICK_DEAD_ZONE);
  // Axes of the standard mapping grow to the right and down; the base frame's x points away, its y to the left.
  const wanted: TipVelocity = {
    x: -stick(1),
    y: -stick(0),
    z: value(BUTTONS.right_trigger) - value(BUTTONS.left_trigger),
    roll: stick(2),
    pitch: -stick(3),
    yaw: value(BUTTONS.left) - value(BUTTONS.right),
  };
  const velocity = Object.fromEntries(axes.map((axis) => [axis, wanted[axis] ?? 0]).filter(([, share]) => share !== 0));
  const opening = value(BUTTONS.open) - value(BUTTONS.close);
  const tip: JogCommand[] = Object.keys(velocity).length > 0 ? [{ kind: "tip", velocity }] : [];
  return opening === 0 ? tip : [...tip, { kind: "gripper", velocity: { opening } }];
}

/** Dead-man of a gamepad: after a stop it must be released once before it counts again. */
export class DeadMan {
  private locked = true;

  /** Count no more until the button has been seen released. */
  lock(): void {
    this.locked = true;
  }

  /** Return true while the button, held or not now, counts. */
  counts(held: boolean): boolean {
    if (!held) this.locked = false;
    return held && !this.locked;
  }
}
