import type { JointValues } from "../state/state";

/** One pair of keys a joint, in the joints' order: up, and below it on the keyboard, down. */
const UP = ["Digit1", "Digit2", "Digit3", "Digit4", "Digit5", "Digit6", "Digit7"];
const DOWN = ["KeyQ", "KeyW", "KeyE", "KeyR", "KeyT", "KeyY", "KeyU"];

/** How the keys of a joint are told. */
export function keyWords(index: number): string {
  return `${UP[index]?.slice(-1) ?? "–"} / ${DOWN[index]?.slice(-1) ?? "–"}`;
}

/** Whether a key turns one of so many joints. */
export function isJogKey(code: string, joints: number): boolean {
  return [UP, DOWN].some((keys) => keys.slice(0, joints).includes(code));
}

/** The joints that the held keys turn: shares of the servo's joint speed; both keys of a joint hold it. */
export function jogVelocities(held: ReadonlySet<string>, joints: readonly string[], share: number): JointValues {
  const pairs = joints.map((name, index) => {
    const up = held.has(UP[index] ?? "") ? share : 0;
    const down = held.has(DOWN[index] ?? "") ? share : 0;
    return [name, up - down] as const;
  });
  return Object.fromEntries(pairs.filter(([, velocity]) => velocity !== 0));
}
