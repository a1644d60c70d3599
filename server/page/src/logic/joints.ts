import type { Joints, JointValues, State } from "../state/state";
import { t } from "../texts/texts";
import { planningGroup, type GripperInfo, type JointKind, type KnownGroup } from "./robot-info";

/** Return the joints that goals are for: those of the planning group, before it is known all that are driven. */
export function armJoints(known: KnownGroup & Pick<State, "limits">): string[] {
  return planningGroup(known)?.joints ?? Object.keys(known.limits);
}

/** Return the named poses that say something of the planning group's joints, without what they say of others. */
export function groupPoses(known: KnownGroup & Pick<State, "limits" | "named">): State["named"] {
  const joints = new Set(armJoints(known));
  const poses = Object.entries(known.named).flatMap(([name, { saved, joints: all }]) => {
    const own = Object.entries(all).filter(([joint]) => joints.has(joint));
    // A described pose belongs to one group, a saved one has the joints of all.
    const is_of_group = own.length > 0 && (saved || own.length === Object.keys(all).length);
    return is_of_group ? [[name, { saved, joints: Object.fromEntries(own) }] as const] : [];
  });
  return Object.fromEntries(poses);
}

/** Return false for a planning group of several arms: one arm is driven at a time. */
export function isOneArm(known: KnownGroup): boolean {
  return planningGroup(known)?.namespace !== null;
}

export function armGripper(known: KnownGroup): GripperInfo | null {
  return planningGroup(known)?.gripper ?? null;
}

/** Return the position of a gripper that is opened by a share of its range, from where it is unless told; null without one. */
export function openedBy(state: KnownGroup & Pick<State, "joints">, share: number, from?: number | null): number | null {
  const gripper = armGripper(state);
  const present = from ?? currentPositions(state)[gripper?.joints[0] ?? ""];
  if (gripper === null || present === undefined) return null;
  const { open, closed } = gripper;
  return Math.min(Math.max(present + share * (open - closed), Math.min(open, closed)), Math.max(open, closed));
}

/** Return the begin of the names of the topics and services by which the arm of the planning group is steered. */
export function armNamespace(known: KnownGroup): string {
  return planningGroup(known)?.namespace ?? "";
}

/** Number of joints from which on a pose of the tool has an orientation of its own choice. */
const POSE_JOINTS = 6;

/** Return true when targets of the planning group are whole poses, and not points alone. */
export function takesOrientation(known: Parameters<typeof armJoints>[0]): boolean {
  return armJoints(known).length >= POSE_JOINTS;
}

/** Return the kind of a joint; one that the server does not name turns. */
export function jointKind({ robot }: Pick<State, "robot">, name: string): JointKind {
  return robot?.joints[name] ?? "revolute";
}

/** Return the position of a joint as it is shown: that of a continuous joint within half a turn of zero. */
export function shownPosition(value: number, kind: JointKind): number {
  return kind === "continuous" ? value - 2 * Math.PI * Math.round(value / (2 * Math.PI)) : value;
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
  unknown: string[];
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

export function unknownNamesText(report: JointReport, known: ReadonlySet<string>): string {
  if (report.unknown.length === 0) return "";
  return t("picture.joints.unknown", { names: report.unknown.join(", "), known: [...known].join(", ") });
}

export function withoutNumberText(report: JointReport): string {
  if (report.without_number.length === 0) return "";
  return t("picture.joints.no_number", { names: report.without_number.join(", ") });
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
