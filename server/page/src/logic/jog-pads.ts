import { shaped, type JogCommand, type TipAxis } from "./jog";

/** Way of the thumb from where it has landed to full speed [px]: as far as it reaches without the hand moving. */
export const PAD_REACH_PX = 60;

/** Share of the reach in which nothing moves, so that a thumb may rest. */
const DEAD_ZONE = 0.12;

/** Axes of a pad: moved by a thumb to the right, and by one upwards, with their signs. */
export interface PadAxes {
  right: readonly [TipAxis, 1 | -1] | null;
  up: readonly [TipAxis, 1 | -1] | null;
}

/** Left pad: away from and to the side of the arm's foot. */
export const LEFT_PAD: PadAxes = { right: ["y", -1], up: ["x", 1] };

/** Return the axes of the right pad: up and down, and across a rotation that the user chooses. */
export function rightPad(rotation: TipAxis | null): PadAxes {
  return { right: rotation && [rotation, 1], up: ["z", 1] };
}

/** Return the command of a thumb that is so far from where it has landed [px, downwards positive]. */
export function padCommand(axes: PadAxes, right_px: number, down_px: number): JogCommand {
  const velocity: Partial<Record<TipAxis, number>> = {};
  const set = (axis: PadAxes["up"], way_px: number): void => {
    const share = shaped(way_px / PAD_REACH_PX, DEAD_ZONE);
    if (axis && share !== 0) velocity[axis[0]] = axis[1] * share;
  };
  set(axes.right, right_px);
  set(axes.up, -down_px);
  return { kind: "tip", velocity };
}
