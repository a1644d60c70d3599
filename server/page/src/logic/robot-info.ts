import type { State } from "../state/state";

/** Kinds of joints with one position: an angle within limits, any angle, a length. */
export type JointKind = "revolute" | "continuous" | "prismatic";

/** Gripper: joints that all go to the same position, in radians or metres. */
export interface GripperInfo {
  joints: string[];
  open: number;
  closed: number;
  action: string;
}

export interface JointGroup {
  name: string;
  joints: string[];
  /** Link at its end; null for a group that is no chain. */
  tip: string | null;
  touch_links: string[];
  /** Begin of the names of its arm's topics and services, empty for an only arm; null for joints of several arms. */
  namespace: string | null;
  gripper: GripperInfo | null;
}

/** Robot as the server describes it on /armbridge/robot. */
export interface RobotInfo {
  joints: Record<string, JointKind>;
  default_group: string;
  groups: JointGroup[];
  /** Bound of the distance of any tip from the root link. */
  reach_m: number;
}

export type KnownGroup = Pick<State, "robot" | "group">;

/** Return the group that goals are for: the selected one, else the default; null before the robot is known. */
export function planningGroup({ robot, group }: KnownGroup): JointGroup | null {
  const named = (name: string): JointGroup | undefined => robot?.groups.find((each) => each.name === name);
  return named(group) ?? named(robot?.default_group ?? "") ?? robot?.groups[0] ?? null;
}
