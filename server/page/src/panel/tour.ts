import { openPanel } from "../logic/layout";
import { t, type TextKey } from "../texts/texts";
import type { PanelContext } from "./context";
import { button, el, setText } from "./dom";

/** Steps of the tour: a text, and the element that it points at. */
const STEPS: readonly [TextKey, string][] = [
  ["tour.ball", "#view"],
  ["tour.primary", ".transport"],
  ["tour.stop", "#stop"],
  ["tour.more", "#rail"],
];

/** Create the tour of the page, with the button that begins it. */
export function createTour({ store }: PanelContext): { card: HTMLElement; start: HTMLElement } {
  let step = 0;
  const text = el("p", { testid: "tour-text", role: "status" });
  const show = (): void => {
    for (const [index, [key, selector]] of STEPS.entries()) {
      const current = index === step && !card.hidden;
      document.querySelector(selector)?.classList.toggle("pointed-at", current);
      if (current) setText(text, t(key));
    }
    setText(next, t(step + 1 < STEPS.length ? "tour.next" : "tour.end"));
  };
  const next = button("", "tour-next", () => {
    step += 1;
    card.hidden = step >= STEPS.length;
    show();
  });
  next.classList.add("primary");
  const card = el("aside", { class: "first-motion", testid: "tour", label: t("tour.title") }, text, next);
  card.hidden = true;
  const start = button(t("tour.title"), "tour-start", () => {
    step = 0;
    card.hidden = false;
    // The ball and the button belong to Move.
    store.set({ layout: openPanel(store.state.layout, "move") });
    show();
    next.focus();
  });
  return { card, start };
}
