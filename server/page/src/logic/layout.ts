/** Columns beside the arm. */
export const COLUMNS = ["first", "second"] as const;
export type Column = (typeof COLUMNS)[number];

/** Panels of each column in the order of their tabs, and the one that each column shows; closed ones are in neither. */
export interface Layout {
  panels: Record<Column, string[]>;
  shown: Record<Column, string>;
}

/** Layout of a page that nobody has arranged yet. */
export const INITIAL_LAYOUT: Layout = {
  panels: { first: ["move", "drive", "sequence", "world", "plots", "goals", "arm", "log", "settings"], second: [] },
  shown: { first: "move", second: "" },
};

/** Return the layout with a panel opened, in its column, or the first one. */
export function openPanel(layout: Layout, id: string): Layout {
  const column = columnOf(layout, id);
  if (column !== null) return { ...layout, shown: { ...layout.shown, [column]: id } };
  return {
    panels: { ...layout.panels, first: [...layout.panels.first, id] },
    shown: { ...layout.shown, first: id },
  };
}

/** Return the layout without a panel; its column shows the panel before it. */
export function closePanel(layout: Layout, id: string): Layout {
  const column = columnOf(layout, id);
  if (column === null) return layout;
  const before = layout.panels[column];
  const left = before.filter((other) => other !== id);
  const neighbour = left[Math.max(0, before.indexOf(id) - 1)] ?? "";
  const shown = layout.shown[column] === id ? neighbour : layout.shown[column];
  return { panels: { ...layout.panels, [column]: left }, shown: { ...layout.shown, [column]: shown } };
}

/** Return the layout with a panel moved to the other column, which shows it. */
export function movePanel(layout: Layout, id: string): Layout {
  const from = columnOf(layout, id);
  if (from === null) return layout;
  const to = from === "first" ? "second" : "first";
  const without = closePanel(layout, id);
  return {
    panels: { ...without.panels, [to]: [...without.panels[to], id] },
    shown: { ...without.shown, [to]: id },
  };
}

/** Return the column of a panel; null for a closed one. */
export function columnOf(layout: Layout, id: string): Column | null {
  return COLUMNS.find((column) => layout.panels[column].includes(id)) ?? null;
}

/** Return a stored layout with the panels that exist, those that are new since then open; the initial one for a text that is none. */
export function parseLayout(text: string, ids: readonly string[], initial: Layout): Layout {
  try {
    const { panels, shown, known = ids } = JSON.parse(text) as Layout & { known?: readonly string[] };
    const existing = (column: Column): string[] => panels[column].filter((id) => ids.includes(id));
    const second = existing("second").filter((id) => !panels.first.includes(id));
    const added = ids.filter((id) => !known.includes(id));
    const kept = { first: [...new Set([...existing("first"), ...added])], second: [...new Set(second)] };
    const of = (column: Column): string => (kept[column].includes(shown[column]) ? shown[column] : (kept[column][0] ?? ""));
    return { panels: kept, shown: { first: of("first"), second: of("second") } };
  } catch {
    return initial;
  }
}
