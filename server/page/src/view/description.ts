import { descriptionProblem, hasNumbers, type DescriptionParts } from "../logic/description";

/** A robot description that was read, and can be drawn. */
export interface Description {
  document: Document;
  parts: DescriptionParts;
}

/** Reads a robot description; throws an Error whose message says why it cannot be drawn. */
export function readDescription(urdf: string): Description {
  const xml = new DOMParser().parseFromString(urdf, "text/xml");
  const broken = xml.querySelector("parsererror");
  if (broken !== null) throw new Error(xmlProblem(broken));
  const root = xml.documentElement;
  if (root.nodeName !== "robot") throw new Error(`its root is <${root.nodeName}>, not <robot>`);
  const parts = partsOf(root);
  const problem = descriptionProblem(parts);
  if (problem !== "") throw new Error(problem);
  return { document: xml, parts };
}

function xmlProblem(broken: Element): string {
  const text = broken.textContent ?? "";
  return `it is no XML (${text.match(/error on line \d+[^\n]*/)?.[0].trim() ?? "it cannot be read"})`;
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

// Which attributes of which elements hold how many numbers; the first ones may be left out.
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
