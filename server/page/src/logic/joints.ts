import type { Joints, JointValues, State } from "../state/state";

/** Parts of the state that tell which joints there are. */
type RobotInfo = Pick<State, "limits" | "named" | "urdf" | "joints">;

/** Return the joints of the planning group: those of the named states; without any, all but the gripper. */
export function armJoints(known: RobotInfo): string[] {
  const names = Object.keys(jointLimits(known));
  const in_states = new Set(Object.values(known.named).flatMap(({ joints }) => Object.keys(joints)));
  if (in_states.size > 0) return names.filter((name) => in_states.has(name));
  return names.filter((name) => name !== "gripper");
}

/** Return the joint of the gripper; null without one. */
export function gripperJoint(known: RobotInfo): string | null {
  const arm = new Set(armJoints(known));
  return Object.keys(jointLimits(known)).find((name) => !arm.has(name)) ?? null;
}

/** Return the joint limits: those of the server, within those of the robot description [rad]. */
export function jointLimits({ limits, urdf }: Pick<State, "limits" | "urdf">): Record<string, [number, number]> {
  const described = urdf === null ? {} : urdfLimits(urdf);
  if (Object.keys(limits).length === 0) return described;
  const pairs = Object.entries(limits).map(([name, [low, high]]) => {
    const [lower, upper] = described[name] ?? [low, high];
    const within: [number, number] = [Math.max(low, lower), Math.min(high, upper)];
    // Of limits that exclude each other take the server's, which are those that reject goals.
    return [name, within[0] <= within[1] ? within : [low, high]] as const;
  });
  return Object.fromEntries(pairs) as Record<string, [number, number]>;
}

/** Limits of the last description, as every update of the panel needs them once per joint. */
let cached: { urdf: string; limits: Record<string, [number, number]> } | null = null;

function urdfLimits(urdf: string): Record<string, [number, number]> {
  if (cached?.urdf === urdf) return cached.limits;
  const limits: Record<string, [number, number]> = {};
  for (const [, attributes = "", inside = ""] of urdf.matchAll(/<joint\b([^>]*[^/>])>([\s\S]*?)<\/joint>/g)) {
    const limit = inside.match(/<limit\b[^>]*>/)?.[0] ?? "";
    const [lower, upper] = [attributeValue(limit, "lower"), attributeValue(limit, "upper")];
    const name = attributes.match(/\bname\s*=\s*["']([^"']*)/)?.[1];
    if (name !== undefined && lower < upper) limits[name] = [lower, upper];
  }
  cached = { urdf, limits };
  return limits;
}

function attributeValue(tag: string, attribute: string): number {
  return Number(tag.match(new RegExp(`\\b${attribute}\\s*=\\s*["']([^"']+)`))?.[1] ?? Number.NaN);
}

/** Return the measured positions, without joints that have no number. */
export function currentPositions({ joints }: Pick<State, "joints">): JointValues {
  const pairs = joints.names.map((name, index) => [name, joints.position_rad[index]] as const);
  return Object.fromEntries(pairs.filter((pair): pair is [string, number] => Number.isFinite(pair[1])));
}

/** Return the positions that the joint rows show: those of the selected goal, else the measured ones. */
export function displayedPositions(state: Pick<State, "joints" | "selection" | "target">): JointValues {
  const { selection, target } = state;
  const selected = selection.kind === "target" ? target.joints_rad : selection.joints_rad;
  return { ...currentPositions(state), ...(selection.kind === "none" ? {} : selected) };
}

/** Positions of a message of /joint_states that can be drawn, and its mistakes. */
export interface JointReport {
  values: JointValues;
  /** Names that the robot description does not have. */
  unknown: string[];
  /** Known joints whose position is not a finite number. */
  without_number: string[];
}

/** Compare a message of /joint_states with the joints of the robot description. */
export function jointReport(joints: Joints, known: ReadonlySet<string>): JointReport {
  const report: JointReport = { values: {}, unknown: [], without_number: [] };
  joints.names.forEach((name, index) => {
    const position_rad = joints.position_rad[index];
    if (!known.has(name)) report.unknown.push(name);
    else if (!Number.isFinite(position_rad)) report.without_number.push(name);
    else report.values[name] = position_rad as number;
  });
  return report;
}

/** Return the notice about unknown names; empty without any. */
export function unknownNamesText(report: JointReport, known: ReadonlySet<string>): string {
  if (report.unknown.length === 0) return "";
  const names = report.unknown.join(", ");
  return `/joint_states names ${names}, which the robot description does not have. It has ${[...known].join(", ")}.`;
}

/** Return the notice about positions that are not finite; empty without any. */
export function withoutNumberText(report: JointReport): string {
  if (report.without_number.length === 0) return "";
  return `/joint_states has no number for ${report.without_number.join(", ")}: drawn where it was last.`;
}

// At half a metre from the joint this is 0.05 mm: less than a pixel.
const INVISIBLE_RAD = 1e-4;

/** Return true when two messages of /joint_states give the same picture. */
export function looksEqual(one: Joints, other: Joints): boolean {
  if (one.names.length !== other.names.length || one.position_rad.length !== other.position_rad.length) return false;
  if (one.names.some((name, index) => name !== other.names[index])) return false;
  return one.position_rad.every((position_rad, index) => {
    const before_rad = other.position_rad[index] ?? Number.NaN;
    return Object.is(position_rad, before_rad) || Math.abs(position_rad - before_rad) < INVISIBLE_RAD;
  });
}
