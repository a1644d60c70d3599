import { t } from "../texts/texts";

/** Parts of a robot description that are checked before it is drawn. */
export interface DescriptionParts {
  links: string[];
  joints: { name: string; parent: string; child: string; mimic: string | null }[];
  /** Links with a <visual> or <collision> that has no shape. */
  without_shape: string[];
  /** Attributes that should be numbers, as `link "a": <box size="x">`. */
  without_numbers: string[];
}

/** Return the reason that a robot description cannot be drawn, as a sentence; empty when it can. */
export function descriptionProblem(parts: DescriptionParts): string {
  const links = new Set(parts.links);
  if (links.size === 0) return t("picture.urdf.no_link");
  const joints = new Set(parts.joints.map((joint) => joint.name));
  const children = new Map<string, string>();
  for (const joint of parts.joints) {
    for (const link of [joint.parent, joint.child]) {
      if (!links.has(link)) return t("picture.urdf.unknown_link", { joint: joint.name, link });
    }
    const other = children.get(joint.child);
    if (other !== undefined) return t("picture.urdf.two_joints", { link: joint.child, one: other, other: joint.name });
    children.set(joint.child, joint.name);
    if (joint.mimic !== null && !joints.has(joint.mimic)) {
      return t("picture.urdf.unknown_mimic", { joint: joint.name, mimic: joint.mimic });
    }
  }
  const roots = parts.links.filter((link) => !children.has(link));
  if (roots.length === 0) return t("picture.urdf.no_root");
  if (roots.length > 1) return t("picture.urdf.roots", { count: roots.length, names: roots.join(", ") });
  if (parts.without_shape.length > 0) return t("picture.urdf.no_shape", { link: parts.without_shape[0] ?? "" });
  return parts.without_numbers.length > 0 ? t("picture.urdf.no_numbers", { attribute: parts.without_numbers[0] ?? "" }) : "";
}

/** Return true when an attribute holds exactly so many numbers. */
export function hasNumbers(text: string | null, count: number): boolean {
  const words = text?.trim().split(/\s+/) ?? [];
  return words.length === count && words.every((word) => word !== "" && Number.isFinite(Number(word)));
}

/** Return the link that is the most joints away from the root, for use as the tip. */
export function farthestLink(parts: DescriptionParts): string | null {
  const parent = new Map(parts.joints.map((joint) => [joint.child, joint.parent]));
  const depth = (link: string): number => {
    let steps = 0;
    for (let at = parent.get(link); at !== undefined && steps <= parent.size; at = parent.get(at)) steps += 1;
    return steps;
  };
  return parts.links.reduce<string | null>(
    (best, link) => (best === null || depth(link) > depth(best) ? link : best),
    null,
  );
}


/** Robot description that can be drawn. */
export interface Description {
  document: Document;
  parts: DescriptionParts;
}

/** Read a robot description; throw an Error with the reason when it cannot be drawn. */
export function readDescription(urdf: string): Description {
  const xml = new DOMParser().parseFromString(urdf, "text/xml");
  const broken = xml.querySelector("parsererror");
  if (broken !== null) throw new Error(xmlProblem(broken));
  const root = xml.documentElement;
  if (root.nodeName !== "robot") throw new Error(t("picture.urdf.root", { name: root.nodeName }));
  const parts = partsOf(root);
  const problem = descriptionProblem(parts);
  if (problem !== "") throw new Error(problem);
  return { document: xml, parts };
}

function xmlProblem(broken: Element): string {
  const text = broken.textContent ?? "";
  return t("picture.urdf.no_xml", { reason: text.match(/error on line \d+[^\n]*/)?.[0].trim() ?? t("picture.urdf.unreadable") });
}

function partsOf(root: Element): DescriptionParts {
  const links = elements(root, "link");
  return {
    links: links.map((link) => link.getAttribute("name") ?? ""),
    joints: elements(root, "joint").map((joint) => ({
      name: joint.getAttribute("name") ?? "",
      parent: elements(joint, "parent")[0]?.getAttribute("link") ?? "",
      child: elements(joint, "child")[0]?.getAttribute("link") ?? "",
      mimic: elements(joint, "mimic")[0]?.getAttribute("joint") ?? null,
    })),
    without_numbers: [...elements(root, "link"), ...elements(root, "joint")].flatMap(withoutNumbers),
    without_shape: links.filter(hasEmptyGeometry).map((link) => link.getAttribute("name") ?? ""),
  };
}

function elements(of: Element, name: string): Element[] {
  return [...of.children].filter((child) => child.nodeName === name);
}

function hasEmptyGeometry(link: Element): boolean {
  const shapes = [...elements(link, "visual"), ...elements(link, "collision")];
  return shapes.some((shape) => elements(shape, "geometry").some((geometry) => geometry.children.length === 0));
}

// Element, attribute and count of its numbers; the first table's attributes are optional.
const OPTIONAL_NUMBERS: [string, string, number][] = [
  ["origin", "xyz", 3],
  ["origin", "rpy", 3],
  ["mesh", "scale", 3],
];
const NUMBERS: [string, string, number][] = [
  ["axis", "xyz", 3],
  ["box", "size", 3],
  ["sphere", "radius", 1],
  ["cylinder", "radius", 1],
  ["cylinder", "length", 1],
];

function withoutNumbers(part: Element): string[] {
  const wrong = ([name, attribute, count]: [string, string, number], optional: boolean): string[] =>
    [...part.getElementsByTagName(name)]
      .filter((element) => !(optional && !element.hasAttribute(attribute)))
      .filter((element) => !hasNumbers(element.getAttribute(attribute), count))
      .map((element) => `${part.nodeName} "${part.getAttribute("name")}": ${written(element, attribute)}`);
  return [...OPTIONAL_NUMBERS.flatMap((rule) => wrong(rule, true)), ...NUMBERS.flatMap((rule) => wrong(rule, false))];
}

function written(element: Element, attribute: string): string {
  return `<${element.nodeName} ${attribute}="${element.getAttribute(attribute) ?? ""}">`;
}
