import { shaped, type JogCommand, type TipAxis, type TipVelocity } from "./jog";

/** Parts of a Gamepad with the standard mapping (W3C Gamepad, section 5) that are read. */
export interface GamepadReading {
  axes: readonly number[];
  buttons: readonly { pressed: boolean; value: number }[];
}

/** Deflection up to which a stick counts as centred; worn sticks rest at up to 0.1. */
const DEAD_ZONE = 0.15;

/** Indices of the standard mapping. */
const BUTTONS = { close: 0, open: 1, left_shoulder: 4, right_shoulder: 5, left_trigger: 6, right_trigger: 7, left: 14, right: 15 };

/** Return true while a dead-man button, either shoulder button, is held. */
export function isDeadManHeld({ buttons }: GamepadReading): boolean {
  return [BUTTONS.left_shoulder, BUTTONS.right_shoulder].some((index) => buttons[index]?.pressed === true);
}

/** Return the commands of a gamepad; none while neither dead-man button is held. */
export function gamepadCommands(pad: GamepadReading, axes: readonly TipAxis[]): JogCommand[] {
  if (!isDeadManHeld(pad)) return [];
  const stick = (index: number): number => shaped(pad.axes[index] ?? 0, DEAD_ZONE);
  const value = (index: number): number => shaped(pad.buttons[index]?.value ?? 0, DEAD_ZONE);
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
