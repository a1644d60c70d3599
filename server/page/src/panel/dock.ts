import { closePanel, INITIAL_LAYOUT, isOpen, openPanel, parseLayout, PICTURE_ALONE, pinPanel, type Layout } from "../logic/layout";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { button, el, icon, loadPreference, storePreference } from "./dom";

/** Panel of the page; its sections exist from the start, also while it is closed. */
export interface Panel {
  id: string;
  title: string;
  /** SVG path of its icon, in a square of 24. */
  icon: string;
  /** On the rail itself, or in its menu. */
  place: "rail" | "more";
  sections: HTMLElement[];
}

/** Dispatched at a panel's element when it comes into sight. */
const SHOWN = "panel-shown";

const MORE_ICON = "M5 12h.01M12 12h.01M19 12h.01";
const PIN_ICON = "M9 4h6l-1 6 4 4H6l4-4zM12 14v6";

/** Screens with space for the picture and one panel only, which are those of phones. */
const SMALL_SCREEN = "(max-width: 760px), (max-height: 500px)";

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

/** Fill the rail with a button for each panel, and the dock with the panels as cards; the browser stores the open ones. */
export function createDock(rail: HTMLElement, dock: HTMLElement, panels: readonly Panel[], store: PageStore): void {
  const small = matchMedia(SMALL_SCREEN);
  const change = (layout: Layout): void => store.set({ layout: small.matches ? { ...layout, pinned: "" } : layout });
  const toggle = (id: string): void => {
    const { layout } = store.state;
    change(isOpen(layout, id) ? closePanel(layout, id) : openPanel(layout, id));
  };
  const tabs = new Map(panels.map((panel) => [panel.id, tabOf(panel, () => toggle(panel.id))]));
  const close = (id: string): void => {
    change(closePanel(store.state.layout, id));
    // That of a panel of the menu is hidden.
    const tab = tabs.get(id);
    (tab?.checkVisibility() ? tab : more.summary).focus();
  };
  const cards = new Map(panels.map((panel) => [panel.id, cardOf(panel, () => close(panel.id), () => change(pinPanel(store.state.layout)))]));
  const placed = (place: Panel["place"]): HTMLElement[] => panels.filter((panel) => panel.place === place).flatMap(({ id }) => tabs.get(id) ?? []);
  const more = moreMenu(placed("more"));
  rail.setAttribute("aria-label", t("layout.panels"));
  rail.append(...placed("rail"), more.details);
  dock.setAttribute("aria-label", t("layout.panels"));
  dock.append(...cards.values());
  const initial = small.matches ? PICTURE_ALONE : INITIAL_LAYOUT;
  change(parseLayout(loadPreference("shown-panels", ""), panels.map(({ id }) => id), initial));
  store.subscribe(
    (state) => state.layout,
    (layout) => {
      storePreference("shown-panels", JSON.stringify(layout));
      dock.hidden = layout.shown === "" && layout.pinned === "";
      more.details.dataset["current"] = String(panels.some(({ id, place }) => place === "more" && isOpen(layout, id)));
      for (const [id, card] of cards) showCard(card, id, layout);
      for (const [id, tab] of tabs) tab.setAttribute("aria-expanded", String(isOpen(layout, id)));
    },
  );
}

function tabOf({ id, title, icon: path }: Panel, press: () => void): HTMLElement {
  const tab = button("", `tab-${id}`, press);
  tab.id = `tab-${id}`;
  tab.setAttribute("aria-controls", `panel-${id}`);
  tab.append(icon(path), el("span", { text: title }));
  return tab;
}

function cardOf({ id, title, sections }: Panel, close: () => void, pin: () => void): HTMLElement {
  const heading = el("h2", { id: `title-${id}`, text: title });
  const pin_button = button("", `pin-panel-${id}`, pin, t("layout.pin"));
  pin_button.classList.add("pin");
  pin_button.setAttribute("aria-label", `${t("layout.pin")}: ${title}`);
  pin_button.append(icon(PIN_ICON));
  const close_button = button("×", `close-panel-${id}`, close, t("layout.close"));
  close_button.setAttribute("aria-label", `${t("layout.close")}: ${title}`);
  // Focusable, so that the keyboard scrolls it.
  const body = el("div", { class: "panel", testid: `panel-${id}`, role: "group", attributes: { tabindex: "0", "aria-labelledby": heading.id } }, ...sections);
  const card = el("section", { class: "card", id: `panel-${id}`, attributes: { "aria-labelledby": heading.id } });
  card.append(el("header", { class: "card-head" }, heading, pin_button, close_button), body);
  card.hidden = true;
  return card;
}

function showCard(card: HTMLElement, id: string, layout: Layout): void {
  card.dataset["slot"] = layout.pinned === id ? "pinned" : "shown";
  const shown = isOpen(layout, id);
  if (card.hidden === !shown) return;
  card.hidden = !shown;
  if (shown) card.dispatchEvent(new Event(SHOWN, { bubbles: true }));
}

/** Create the menu of the other panels; a press and the loss of the focus close it. */
function moreMenu(tabs: readonly HTMLElement[]): { details: HTMLDetailsElement; summary: HTMLElement } {
  const summary = el("summary", { testid: "more-panels" }, icon(MORE_ICON), el("span", { text: t("layout.more") }));
  const details = el("details", { class: "more" }, summary, el("div", { class: "menu" }, ...tabs));
  details.addEventListener("click", ({ target }) => {
    if (target instanceof Element && target.closest("button")) details.open = false;
  });
  details.addEventListener("focusout", ({ relatedTarget }) => {
    if (relatedTarget instanceof Node && !details.contains(relatedTarget)) details.open = false;
  });
  document.addEventListener("pointerdown", ({ target }) => {
    if (target instanceof Node && !details.contains(target)) details.open = false;
  });
  return { details, summary };
}
