import type { Joints, JointValues, State } from "../state/state";
import { t } from "../texts/texts";
import { planningGroup, robotInfo, type GripperInfo, type JointKind } from "./robot-info";

/** Parts of the state that describe the joints, groups and arms. */
type KnownJoints = Pick<State, "limits" | "named" | "urdf" | "srdf" | "group" | "actions">;

/** Return the joints that goals are for: those of the planning group that are driven; without groups, all. */
export function armJoints(known: KnownJoints): string[] {
  const driven = Object.keys(jointLimits(known));
  const group = planningGroup(known);
  return group === null ? driven : group.joints.filter((name) => driven.includes(name));
}

/** Return the named poses that say something of the planning group's joints, without what they say of others. */
export function groupPoses(known: KnownJoints): State["named"] {
  const joints = new Set(armJoints(known));
  const poses = Object.entries(known.named).flatMap(([name, { saved, joints: all }]) => {
    const own = Object.entries(all).filter(([joint]) => joints.has(joint));
    // A described pose belongs to one group, a saved one has the joints of all.
    const is_of_group = own.length > 0 && (saved || own.length === Object.keys(all).length);
    return is_of_group ? [[name, { saved, joints: Object.fromEntries(own) }] as const] : [];
  });
  return Object.fromEntries(poses);
}

/** Return false for a planning group of several arms: nothing can be asked of its tip, and one arm is driven at a time. */
export function hasTip(known: Pick<State, "urdf" | "srdf" | "group">): boolean {
  return planningGroup(known)?.tip !== null;
}

/** Most fingers of a gripper. */
const MAX_FINGERS = 2;

/** Return the gripper of the planning group: that of its end effector, else the joints of no group; null without one. */
export function armGripper(known: KnownJoints): GripperInfo | null {
  if (!hasTip(known)) return null;
  const { groups, grippers } = robotInfo(known);
  const limits = jointLimits(known);
  const parent = planningGroup(known)?.name ?? "";
  const of_group = grippers.find(({ parent_group }) => parent_group === parent) ?? grippers[0];
  const gripper = of_group?.gripper ?? gripperOf(limits, groups.flatMap(({ joints }) => joints));
  const driven = gripper?.joints.every((name) => name in limits) ?? false;
  return gripper && driven && gripperAction(gripper, known.actions) !== null ? gripper : null;
}

/** Return a gripper of the driven joints of no group; null where all have one, or there are more than fingers. */
function gripperOf(limits: Record<string, [number, number]>, in_groups: readonly string[]): GripperInfo | null {
  const joints = Object.keys(limits).filter((name) => in_groups.length > 0 && !in_groups.includes(name));
  const [closed, open] = limits[joints[0] ?? ""] ?? [0, 0];
  return joints.length > 0 && joints.length <= MAX_FINGERS ? { group: "", joints, open, closed } : null;
}

/** Action of each of several arms, below its name. */
const ARM_ACTION = /^\/([^/]+)\/moveit_goal$/;

/** Return the name of the arm that all of some joints belong to; empty on a server with one arm, and for joints of several. */
export function armName(joints: readonly string[], offered: State["actions"]): string {
  const names = (offered ?? []).flatMap((action) => ARM_ACTION.exec(action)?.[1] ?? []);
  const own = names.filter((name) => joints.length > 0 && joints.every((joint) => joint.startsWith(`${name}_`)));
  // Of left and left_hand the longer one, whose joints have the other's name as well.
  return own.sort((a, b) => b.length - a.length)[0] ?? "";
}

/** Return what the names of the topics and services begin with by which the arm of the planning group is steered. */
export function armNamespace(known: KnownJoints): string {
  const name = armName(armJoints(known), known.actions);
  return name === "" ? "" : `/${name}`;
}

/** Controller of the gripper of an arm that has one. */
const GRIPPER_CONTROLLER = "/gripper_controller";

/** Return the action that moves a gripper; null when the server offers none. */
export function gripperAction(gripper: GripperInfo, offered: State["actions"]): string | null {
  const arm = armName(gripper.joints, offered);
  const below = arm === "" ? [] : [`/${arm}/${gripper.group.slice(arm.length + 1)}_controller`, `/${arm}${GRIPPER_CONTROLLER}`];
  const controllers = [...below, `/${gripper.group}_controller`, GRIPPER_CONTROLLER];
  const names = controllers.flatMap((controller) => ["gripper_cmd", "gripper_action"].map((name) => `${controller}/${name}`));
  // Before the server has answered, or where it tells nobody, the usual one.
  if (offered === null) return `${GRIPPER_CONTROLLER}/gripper_cmd`;
  return names.find((name) => offered.includes(name)) ?? null;
}

/** Number of joints from which on a pose of the tool has an orientation of its own choice. */
const POSE_JOINTS = 6;

/** Return true when targets of the planning group are whole poses, and not points alone. */
export function takesOrientation(known: KnownJoints): boolean {
  return armJoints(known).length >= POSE_JOINTS;
}

/** Return the kind of a joint; one that the description does not have turns. */
export function jointKind(known: Pick<State, "urdf" | "srdf">, name: string): JointKind {
  return robotInfo(known).joints.get(name)?.kind ?? "revolute";
}

/** Return the joint limits: those of the server, within those of the robot description [rad or m]. */
export function jointLimits(known: Pick<State, "limits" | "urdf" | "srdf">): Record<string, [number, number]> {
  const described = robotInfo(known).joints;
  const { limits } = known;
  if (Object.keys(limits).length === 0) {
    return Object.fromEntries([...described.values()].map((joint) => [joint.name, joint.limits]));
  }
  const pairs = Object.entries(limits).map(([name, [low, high]]) => {
    const [lower, upper] = described.get(name)?.limits ?? [low, high];
    const within: [number, number] = [Math.max(low, lower), Math.min(high, upper)];
    // Of limits that exclude each other take the server's, which are those that reject goals.
    return [name, within[0] <= within[1] ? within : [low, high]] as const;
  });
  return Object.fromEntries(pairs) as Record<string, [number, number]>;
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
  return t("picture.joints.unknown", { names: report.unknown.join(", "), known: [...known].join(", ") });
}

/** Return the notice about positions that are not finite; empty without any. */
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
