import type { Joints, JointValues } from "../state/state";

/** What can be drawn of a message of /joint_states, and what is wrong with it. */
export interface JointReport {
  values: JointValues;
  /** Names that the robot description does not have. */
  unknown: string[];
  /** Known joints whose position is not a finite number. */
  without_number: string[];
}

/** Sorts a message of /joint_states by what the drawn robot knows. */
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

/** The sentence about names that do not match; empty when all do. */
export function unknownNamesText(report: JointReport, known: ReadonlySet<string>): string {
  if (report.unknown.length === 0) return "";
  const names = report.unknown.join(", ");
  return `/joint_states names ${names}, which the robot description does not have. It has ${[...known].join(", ")}.`;
}

/** The sentence about positions that are no numbers; empty when all are. */
export function withoutNumberText(report: JointReport): string {
  if (report.without_number.length === 0) return "";
  return `/joint_states has no number for ${report.without_number.join(", ")}: drawn where it was last.`;
}

// Half a metre away from the joint this is a twentieth of a millimetre: less than a pixel.
const UNSEEN_RAD = 1e-4;

/** Whether two messages of /joint_states give one picture. */
export function looksSame(one: Joints, other: Joints): boolean {
  if (one.names.length !== other.names.length || one.position_rad.length !== other.position_rad.length) return false;
  if (one.names.some((name, index) => name !== other.names[index])) return false;
  return one.position_rad.every((position_rad, index) => {
    const before_rad = other.position_rad[index] ?? Number.NaN;
    return Object.is(position_rad, before_rad) || Math.abs(position_rad - before_rad) < UNSEEN_RAD;
  });
}
