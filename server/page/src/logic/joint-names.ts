import type { JointValues, State } from "../state/state";

type Known = Pick<State, "limits" | "named" | "urdf" | "joints">;

/** The joints that goals are for: those of the named states; without any, all but the gripper. */
export function armJoints(known: Known): string[] {
  const limited = Object.keys(limitsOf(known));
  const inStates = new Set(Object.values(known.named).flatMap(({ joints }) => Object.keys(joints)));
  if (inStates.size > 0) return limited.filter((name) => inStates.has(name));
  return limited.filter((name) => name !== "gripper");
}

/** The joint of the gripper; null without one. */
export function gripperJoint(known: Known): string | null {
  const arm = new Set(armJoints(known));
  return Object.keys(limitsOf(known)).find((name) => !arm.has(name)) ?? null;
}

/** Limits of the joints: those that the server keeps, within those of the robot description. */
export function limitsOf({ limits, urdf }: Pick<State, "limits" | "urdf">): Record<string, [number, number]> {
  const described = urdf === null ? {} : describedLimits(urdf);
  if (Object.keys(limits).length === 0) return described;
  const pairs = Object.entries(limits).map(([name, [low, high]]) => {
    const [lower, upper] = described[name] ?? [low, high];
    const within: [number, number] = [Math.max(low, lower), Math.min(high, upper)];
    // Two that exclude each other are a mistake somewhere: the server's are those that refuse goals.
    return [name, within[0] <= within[1] ? within : [low, high]] as const;
  });
  return Object.fromEntries(pairs) as Record<string, [number, number]>;
}

let read: { urdf: string; limits: Record<string, [number, number]> } | null = null;

function describedLimits(urdf: string): Record<string, [number, number]> {
  if (read?.urdf === urdf) return read.limits;
  const limits: Record<string, [number, number]> = {};
  for (const [, attributes = "", inside = ""] of urdf.matchAll(/<joint\b([^>]*[^/>])>([\s\S]*?)<\/joint>/g)) {
    const limit = inside.match(/<limit\b[^>]*>/)?.[0] ?? "";
    const [lower, upper] = [number(limit, "lower"), number(limit, "upper")];
    const name = attributes.match(/\bname\s*=\s*["']([^"']*)/)?.[1];
    if (name !== undefined && lower < upper) limits[name] = [lower, upper];
  }
  read = { urdf, limits };
  return limits;
}

function number(tag: string, attribute: string): number {
  return Number(tag.match(new RegExp(`\\b${attribute}\\s*=\\s*["']([^"']+)`))?.[1] ?? Number.NaN);
}

/** Where the joints are, those without a number left out. */
export function present({ joints }: Pick<State, "joints">): JointValues {
  const pairs = joints.names.map((name, index) => [name, joints.position_rad[index]] as const);
  return Object.fromEntries(pairs.filter((pair): pair is [string, number] => Number.isFinite(pair[1])));
}

/** What the joint rows show: what is wished for, else where the joints are. */
export function shownJoints(state: Pick<State, "joints" | "wish" | "target">): JointValues {
  const { wish, target } = state;
  const wished = wish.kind === "target" ? target.joints_rad : wish.joints_rad;
  return { ...present(state), ...(wish.kind === "none" ? {} : wished) };
}
