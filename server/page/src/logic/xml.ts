/** Element of an XML text, without its text. */
export interface XmlElement {
  name: string;
  attributes: Record<string, string>;
  children: XmlElement[];
}

// A comment, a declaration or a section of characters; an end tag; or a start tag with its attributes.
const ATTRIBUTE = /([^\s=/]+)\s*=\s*(?:"([^"]*)"|'([^']*)')/g;
const TAG = new RegExp(
  `<!--[\\s\\S]*?-->|<!\\[CDATA\\[[\\s\\S]*?\\]\\]>|<[?!][^>]*>|</([^\\s>]+)\\s*>|` +
    `<([^\\s/>!?]+)((?:\\s+${ATTRIBUTE.source})*)\\s*(/?)>`,
  "g",
);

const ENTITIES: Record<string, string> = { lt: "<", gt: ">", amp: "&", quot: '"', apos: "'" };

/**
 * Return the root element of a text; null without one.
 *
 * The browser's own parser exists in no other program, so what uses it could be tested in a browser alone.
 */
export function readXml(text: string): XmlElement | null {
  const holder: XmlElement = { name: "", attributes: {}, children: [] };
  const open = [holder];
  for (const match of text.matchAll(TAG)) {
    const [, end, start, attributes = ""] = match;
    if (end !== undefined) {
      if (open.length > 1) open.pop();
    } else if (start !== undefined) {
      const element = { name: start, attributes: readAttributes(attributes), children: [] };
      open.at(-1)?.children.push(element);
      if (match.at(-1) !== "/") open.push(element);
    }
  }
  return holder.children[0] ?? null;
}

/** Return the children of an element with a name. */
export function childrenOf(element: XmlElement | null, name: string): XmlElement[] {
  return element?.children.filter((child) => child.name === name) ?? [];
}

/** Return a number of an element's attributes; NaN where there is none. */
export function numberOf(element: XmlElement | undefined, attribute: string): number {
  const text = element?.attributes[attribute]?.trim() ?? "";
  return text === "" ? Number.NaN : Number(text);
}

function readAttributes(text: string): Record<string, string> {
  const pairs = [...text.matchAll(ATTRIBUTE)].map(([, name = "", double, single]) => [name, double ?? single ?? ""]);
  return Object.fromEntries(pairs.map(([name, value]) => [name, decoded(value ?? "")])) as Record<string, string>;
}

function decoded(text: string): string {
  return text.replace(/&(\w+);/g, (whole, name: string) => ENTITIES[name] ?? whole);
}
