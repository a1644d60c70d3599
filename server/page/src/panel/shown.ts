/** Dispatched at a panel's element when it comes into sight. */
const SHOWN = "panel-shown";

/** Return true while an element can be seen: its panel is open, and no section above it is closed. */
export function isShown(element: HTMLElement): boolean {
  return element.isConnected && element.closest("[hidden], details:not([open])") === null;
}

/** Call back whenever an element has come into sight: what was not drawn meanwhile is drawn then. */
export function whenShown(element: HTMLElement, listener: () => void): void {
  const check = ({ target }: Event): void => {
    if (target instanceof Node && target.contains(element) && isShown(element)) listener();
  };
  document.addEventListener(SHOWN, check);
  // The event of a collapsible section does not bubble.
  document.addEventListener("toggle", check, { capture: true });
}
