/** What is looked at before a robot description is drawn. */
export interface DescriptionParts {
  links: string[];
  joints: { name: string; parent: string; child: string; mimic: string | null }[];
  /** Links with a <visual> or <collision> that has no shape. */
  without_shape: string[];
  /** Attributes that should be numbers, as `link "a": <box size="x">`. */
  without_numbers: string[];
}

/** Why a robot description cannot be drawn, as a sentence; empty when it can. */
export function descriptionProblem(parts: DescriptionParts): string {
  const links = new Set(parts.links);
  if (links.size === 0) return "it has no <link>";
  const joints = new Set(parts.joints.map((joint) => joint.name));
  const children = new Map<string, string>();
  for (const joint of parts.joints) {
    for (const link of [joint.parent, joint.child]) {
      if (!links.has(link)) return `joint "${joint.name}" names link "${link}", which it does not have`;
    }
    const other = children.get(joint.child);
    if (other !== undefined) return `link "${joint.child}" hangs on two joints, "${other}" and "${joint.name}"`;
    children.set(joint.child, joint.name);
    if (joint.mimic !== null && !joints.has(joint.mimic)) {
      return `joint "${joint.name}" mimics "${joint.mimic}", which it does not have`;
    }
  }
  const roots = parts.links.filter((link) => !children.has(link));
  if (roots.length !== 1) return `it needs one root link and has ${roots.length}: ${roots.join(", ") || "none"}`;
  if (parts.without_shape.length > 0) return `link "${parts.without_shape[0]}" has a <geometry> without a shape`;
  return parts.without_numbers.length > 0 ? `${parts.without_numbers[0]} has no numbers` : "";
}

/** Whether an attribute holds exactly so many numbers. */
export function hasNumbers(text: string | null, count: number): boolean {
  const words = text?.trim().split(/\s+/) ?? [];
  return words.length === count && words.every((word) => word !== "" && Number.isFinite(Number(word)));
}

/** The tip of the first chain in a semantic description (SRDF); null when there is none. */
export function tipLink(srdf: string | null): string | null {
  return srdf?.match(/<chain\b[^>]*\btip_link\s*=\s*["']([^"']+)["']/)?.[1] ?? null;
}

/** The link that is the most joints away from the root: the tip where nothing names one. */
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

/** Where the page finds a mesh that a description names; null when it may not be asked for. */
export function meshUrl(uri: string, page: string): string | null {
  const path = uri.replace(/^package:\/\//, "");
  const base = new URL("robot/", page);
  try {
    const url = new URL(path, base);
    return url.href.startsWith(base.href) ? url.href : null;
  } catch {
    return null;
  }
}
