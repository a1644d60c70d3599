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
  const known = AXES_BY_JOINT.slice(0, joints);
  return TIP_AXES.filter((axis) => known.includes(axis));
}

/** Return true for an axis about which the tip turns. */
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

/** Return a command with its velocities multiplied by a factor. */
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
