import type { State } from "../state/state";
import { childrenOf, numberOf, readXml, type XmlElement } from "./xml";

/** Kinds of joints with one position: an angle within limits, any angle, a length. */
export type JointKind = "revolute" | "continuous" | "prismatic";

/** Joint of the robot description that moves by itself. */
export interface JointInfo {
  name: string;
  kind: JointKind;
  /** Limits of its position, in radians or metres; a whole turn for a continuous joint. */
  limits: [number, number];
}

/** Joint group of the semantic description (SRDF). */
export interface JointGroup {
  name: string;
  /** Joints that move by themselves, in the order of the group. */
  joints: string[];
  /** Link at its end; null for a group without joints and links, and for one of several arms. */
  tip: string | null;
}

/** Gripper: a joint group whose joints all go to the same position, in radians or metres. */
export interface GripperInfo {
  /** Name of its group; empty where the semantic description has none. */
  group: string;
  joints: string[];
  open: number;
  closed: number;
}

/** Robot as its descriptions tell it. */
export interface RobotInfo {
  joints: ReadonlyMap<string, JointInfo>;
  /** Groups with joints, but those of grippers. */
  groups: JointGroup[];
  /** Grippers by the name of the group that carries them; the empty name is for any. */
  grippers: { parent_group: string; gripper: GripperInfo }[];
}

const KINDS: readonly string[] = ["revolute", "continuous", "prismatic"];

/** Names of the states of a gripper's group. */
const OPEN = /open/i;
const CLOSED = /clos/i;

/** Group names of grippers in semantic descriptions without <end_effector>. */
const GRIPPER_GROUP = /gripper|hand/i;

/** Robot of the last descriptions, as every update of the panel asks for it. */
let cached: { urdf: string | null; srdf: string | null; info: RobotInfo } | null = null;

/** Return the robot of these descriptions; an empty one without a URDF. */
export function robotInfo({ urdf, srdf }: Pick<State, "urdf" | "srdf">): RobotInfo {
  if (cached?.urdf !== urdf || cached.srdf !== srdf) cached = { urdf, srdf, info: readRobot(urdf ?? "", srdf ?? "") };
  return cached.info;
}

/** Return the group that goals are for: the selected one, else "arm", else the first; null without groups. */
export function planningGroup(state: Pick<State, "urdf" | "srdf" | "group">): JointGroup | null {
  const { groups } = robotInfo(state);
  const named = (name: string): JointGroup | undefined => groups.find((group) => group.name === name);
  return named(state.group) ?? named("arm") ?? groups[0] ?? null;
}

function readRobot(urdf: string, srdf: string): RobotInfo {
  const tree = new JointTree(readXml(urdf));
  const semantics = readXml(srdf);
  const elements = new Map(childrenOf(semantics, "group").map((group) => [group.attributes.name ?? "", group]));
  const passive = new Set(childrenOf(semantics, "passive_joint").map(({ attributes }) => attributes.name));
  const group = (name: string): JointGroup => {
    const { joints, tip } = tree.membersOf(name, elements, new Set());
    const moving = joints.filter((joint) => tree.moving.has(joint) && !passive.has(joint));
    return { name, joints: [...new Set(moving)], tip };
  };
  const groups = [...elements.keys()].map(group).filter(({ joints }) => joints.length > 0);
  const hands = endEffectors(semantics, groups);
  const gripper_groups = new Set(hands.map((hand) => hand.group));
  return {
    joints: tree.moving,
    groups: groups.filter(({ name }) => !gripper_groups.has(name)),
    grippers: hands.flatMap(({ group: name, parent_group }) => {
      const members = groups.find((each) => each.name === name)?.joints ?? [];
      const gripper = readGripper(name, members, tree.moving, semantics);
      return gripper ? [{ parent_group, gripper }] : [];
    }),
  };
}

function endEffectors(semantics: XmlElement | null, groups: JointGroup[]): { group: string; parent_group: string }[] {
  const described = childrenOf(semantics, "end_effector").map(({ attributes }) => ({
    group: attributes.group ?? "",
    parent_group: attributes.parent_group ?? "",
  }));
  if (described.length > 0) return described;
  const by_name = groups.filter(({ name, joints }) => GRIPPER_GROUP.test(name) && joints.length <= 2);
  // A group of its own is no gripper, however it is called.
  return by_name.length < groups.length ? by_name.map(({ name }) => ({ group: name, parent_group: "" })) : [];
}

/** Return a gripper with the positions of its group's states, else with its limits; null without joints. */
function readGripper(
  group: string,
  joints: string[],
  known: ReadonlyMap<string, JointInfo>,
  semantics: XmlElement | null,
): GripperInfo | null {
  const [first = ""] = joints;
  const info = known.get(first);
  if (info === undefined) return null;
  const states = childrenOf(semantics, "group_state").filter(({ attributes }) => attributes.group === group);
  const position = (name: RegExp, fallback: number): number => {
    const state = states.find(({ attributes }) => name.test(attributes.name ?? ""));
    const value = numberOf(
      childrenOf(state ?? null, "joint").find(({ attributes }) => attributes.name === first),
      "value",
    );
    return Number.isFinite(value) ? value : fallback;
  };
  const [closed, open] = info.limits;
  return { group, joints, open: position(OPEN, open), closed: position(CLOSED, closed) };
}

/** Joints of a URDF, which lead from its root link to the others. */
class JointTree {
  readonly moving = new Map<string, JointInfo>();
  /** Joint above each link, and the link above each joint. */
  private readonly above = new Map<string, { joint: string; link: string }>();
  private readonly below = new Map<string, string>();

  constructor(urdf: XmlElement | null) {
    for (const joint of childrenOf(urdf, "joint")) {
      const name = joint.attributes.name ?? "";
      const link = (end: string): string => childrenOf(joint, end)[0]?.attributes.link ?? "";
      this.above.set(link("child"), { joint: name, link: link("parent") });
      this.below.set(name, link("child"));
      const info = readJoint(joint);
      if (info && childrenOf(joint, "mimic").length === 0) this.moving.set(name, info);
    }
  }

  /** Return the joints of a group and of the groups in it, and the link at its end. */
  membersOf(
    name: string,
    groups: ReadonlyMap<string, XmlElement>,
    visited: Set<string>,
  ): { joints: string[]; tip: string | null } {
    const joints: string[] = [];
    let tip: string | null = null;
    let is_one_chain = true;
    // A group that contains itself has no more members than without that.
    if (visited.has(name)) return { joints, tip };
    visited.add(name);
    for (const { name: kind, attributes } of groups.get(name)?.children ?? []) {
      const member = attributes.name ?? "";
      if (kind === "joint") {
        joints.push(member);
        tip = this.below.get(member) ?? tip;
      } else if (kind === "link") {
        const joint = this.above.get(member)?.joint;
        if (joint !== undefined) joints.push(joint);
        tip = member;
      } else if (kind === "chain") {
        const { base_link = "", tip_link = "" } = attributes;
        joints.push(...this.chain(base_link, tip_link));
        tip = tip_link;
      } else if (kind === "group") {
        const inner = this.membersOf(member, groups, visited);
        joints.push(...inner.joints);
        if (tip !== null && inner.tip !== null) is_one_chain &&= this.leadsTo(tip, inner.tip) || this.leadsTo(inner.tip, tip);
        tip = inner.tip ?? tip;
      }
    }
    return { joints, tip: is_one_chain ? tip : null };
  }

  /** Return true for a link on the way from the root to another one, or the same. */
  private leadsTo(upper: string, lower: string): boolean {
    return this.chain("", lower).some((joint) => this.below.get(joint) === upper);
  }

  private chain(base: string, tip: string): string[] {
    const joints: string[] = [];
    let link = tip;
    // No longer than there are joints, so that a loop ends too.
    for (let steps = 0; link !== base && steps <= this.above.size; steps += 1) {
      const above = this.above.get(link);
      if (above === undefined) break;
      joints.unshift(above.joint);
      link = above.link;
    }
    return joints;
  }
}

function readJoint(joint: XmlElement): JointInfo | null {
  const { name = "", type = "" } = joint.attributes;
  if (!KINDS.includes(type)) return null;
  const kind = type as JointKind;
  const limit = childrenOf(joint, "limit")[0];
  const [lower, upper] = [numberOf(limit, "lower"), numberOf(limit, "upper")];
  const turn: [number, number] = [-Math.PI, Math.PI];
  return { name, kind, limits: kind !== "continuous" && lower < upper ? [lower, upper] : turn };
}
