/** Panels that are open beside the picture, by their ids; empty for none. */
export interface Layout {
  /** Panel that was opened last; the next one takes its place. */
  shown: string;
  /** Panel that stays open beside it. */
  pinned: string;
}

export const INITIAL_LAYOUT: Layout = { shown: "move", pinned: "" };

export const PICTURE_ALONE: Layout = { shown: "", pinned: "" };

export function isOpen({ shown, pinned }: Layout, id: string): boolean {
  return id === shown || id === pinned;
}

export function openPanel(layout: Layout, id: string): Layout {
  return isOpen(layout, id) ? layout : { ...layout, shown: id };
}

export function closePanel({ shown, pinned }: Layout, id: string): Layout {
  return { shown: shown === id ? "" : shown, pinned: pinned === id ? "" : pinned };
}

/** Return the layout with the shown panel pinned; the one that was pinned takes its place. */
export function pinPanel({ shown, pinned }: Layout): Layout {
  return { shown: pinned, pinned: shown };
}

/** Return a stored layout without panels that do not exist; the initial one for another text. */
export function parseLayout(text: string, ids: readonly string[], initial: Layout): Layout {
  try {
    const { shown, pinned } = JSON.parse(text) as Partial<Layout>;
    if (typeof shown !== "string" || typeof pinned !== "string") return initial;
    const existing = (id: string): string => (ids.includes(id) ? id : "");
    return { shown: existing(shown), pinned: shown === pinned ? "" : existing(pinned) };
  } catch {
    return initial;
  }
}
