import type { State } from "../state/state";
import { planningGroup } from "./robot-info";
import { childrenOf, readXml, type XmlElement } from "./xml";

/** Link that holds objects, and the links that they may touch meanwhile. */
export interface Holder {
  link: string;
  touch_links: string[];
}

/**
 * Return the holder of objects: the parent link of the end effector of the planning group, else the group's tip.
 *
 * Touched may be the links of the end effector's group, and those that are fixed to the holder: its body is often
 * above the frame between the fingers, which the SRDF names.
 *
 * @returns null before the robot is known.
 */
export function holderOf(state: Pick<State, "urdf" | "srdf" | "group">): Holder | null {
  const group = planningGroup(state);
  if (group === null) return null;
  const semantics = readXml(state.srdf ?? "");
  const effectors = childrenOf(semantics, "end_effector").map(({ attributes }) => attributes);
  const effector = effectors.find(({ parent_group }) => parent_group === group.name) ?? (group.tip === null ? undefined : effectors[0]);
  const link = effector?.parent_link || group.tip;
  if (!link) return null;
  const joints = childrenOf(readXml(state.urdf ?? ""), "joint");
  const links = [...fixedTo(link, joints), ...linksOf(effector?.group ?? "", semantics, joints)];
  return { link, touch_links: [...new Set(links)] };
}

function ends(joint: XmlElement): { parent: string; child: string } {
  const link = (end: string): string => childrenOf(joint, end)[0]?.attributes.link ?? "";
  return { parent: link("parent"), child: link("child") };
}

/** Return a link and those that fixed joints join to it. */
function fixedTo(link: string, joints: readonly XmlElement[]): string[] {
  const fixed = joints.filter(({ attributes }) => attributes.type === "fixed").map(ends);
  const found = [link];
  for (const each of found) {
    for (const { parent, child } of fixed) {
      const other = parent === each ? child : child === each ? parent : "";
      if (other !== "" && !found.includes(other)) found.push(other);
    }
  }
  return found;
}

/** Return the links of a group of the SRDF: those it names, and those that its joints move. */
function linksOf(name: string, semantics: XmlElement | null, joints: readonly XmlElement[]): string[] {
  const group = childrenOf(semantics, "group").find(({ attributes }) => attributes.name === name);
  return (group?.children ?? []).flatMap(({ name: kind, attributes }) => {
    const { name: member = "", base_link = "", tip_link = "" } = attributes;
    if (kind === "link") return [member];
    if (kind === "chain") return chain(base_link, tip_link, joints);
    const joint = joints.find((each) => each.attributes.name === member);
    return kind === "joint" && joint !== undefined ? [ends(joint).child] : [];
  });
}

function chain(base: string, tip: string, joints: readonly XmlElement[]): string[] {
  const links: string[] = [];
  for (let link = tip; link !== "" && link !== base && links.length <= joints.length; ) {
    links.push(link);
    const above = joints.find((joint) => ends(joint).child === link);
    link = above === undefined ? "" : ends(above).parent;
  }
  return links;
}
