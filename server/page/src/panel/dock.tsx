import type { ComponentType, JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { closePanel, isOpen, openPanel, pinPanel, type Layout } from "../logic/layout";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { Icon, Shown, SignButton, usePage } from "./ui";

export interface Panel {
  id: "move" | "drive" | "sequence" | "world" | "plots" | "goals" | "arm" | "cameras" | "recording" | "class" | "log" | "settings";
  icon: string;
  place: "rail" | "more";
  sections: readonly ComponentType[];
}

const MORE_ICON = "M5 12h.01M12 12h.01M19 12h.01";
const PIN_ICON = "M9 4h6l-1 6 4 4H6l4-4zM12 14v6";

/** Screens with space for the picture and one panel only, which are those of phones. */
export const SMALL_SCREEN = matchMedia("(max-width: 760px), (max-height: 500px)");

/** Change the layout; a small screen has no space for a second panel. */
export function changeLayout(store: PageStore, layout: Layout): void {
  store.set({ layout: SMALL_SCREEN.matches ? { ...layout, pinned: "" } : layout });
}

export function Rail({ panels }: { panels: readonly Panel[] }): JSX.Element {
  const { layout, classroom } = usePage().store.state;
  const menu = useRef<HTMLDetailsElement>(null);
  const close = (): void => {
    if (menu.current) menu.current.open = false;
  };
  useEffect(() => {
    const closeElsewhere = ({ target }: PointerEvent): void => {
      if (target instanceof Node && !menu.current?.contains(target)) close();
    };
    document.addEventListener("pointerdown", closeElsewhere);
    return () => document.removeEventListener("pointerdown", closeElsewhere);
  }, []);
  const leave = ({ relatedTarget }: FocusEvent): void => {
    if (relatedTarget instanceof Node && !menu.current?.contains(relatedTarget)) close();
  };
  const more = panels.filter(({ id, place }) => place === "more" && (id !== "class" || classroom.length > 0));
  return (
    <>
      {panels.filter(({ place }) => place === "rail").map((panel) => <Tab key={panel.id} panel={panel} press={() => undefined} />)}
      <details ref={menu} class="more" data-current={String(more.some(({ id }) => isOpen(layout, id)))} onFocusOut={leave}>
        <summary data-testid="more-panels"><Icon path={MORE_ICON} /><span>{t("layout.more")}</span></summary>
        <div class="menu">{more.map((panel) => <Tab key={panel.id} panel={panel} press={close} />)}</div>
      </details>
    </>
  );
}

function Tab({ panel: { id, icon }, press }: { panel: Panel; press: () => void }): JSX.Element {
  const { store } = usePage();
  const is_open = isOpen(store.state.layout, id);
  const toggle = (): void => {
    const { layout } = store.state;
    changeLayout(store, isOpen(layout, id) ? closePanel(layout, id) : openPanel(layout, id));
    press();
  };
  return (
    <button type="button" data-testid={`tab-${id}`} id={`tab-${id}`} aria-controls={`panel-${id}`} aria-expanded={is_open} onClick={toggle}>
      <Icon path={icon} /><span>{t(`panel.${id}`)}</span>
    </button>
  );
}

/** Panel as a card of the dock; its sections exist from its first opening or the first picture on, which would wait for those of all. */
export function Card({ panel: { id, sections } }: { panel: Panel }): JSX.Element {
  const { store } = usePage();
  const { layout } = store.state;
  const card = useRef<HTMLElement>(null);
  const close = (): void => {
    changeLayout(store, closePanel(store.state.layout, id));
    // The button of a panel of the menu is hidden.
    const tab = document.getElementById(`tab-${id}`);
    (tab?.checkVisibility() ? tab : document.querySelector<HTMLElement>(".more > summary"))?.focus();
  };
  const shown = isOpen(layout, id);
  const exists = useRef(false);
  exists.current ||= shown || store.state.drawn;
  useEffect(() => void (shown && card.current?.dispatchEvent(new Event("panel-shown", { bubbles: true }))), [shown]);
  const heading = `title-${id}`;
  return (
    <section ref={card} class="card" id={`panel-${id}`} aria-labelledby={heading} hidden={!shown} data-slot={layout.pinned === id ? "pinned" : "shown"}>
      <header class="card-head">
        <h2 id={heading}>{t(`panel.${id}`)}</h2>
        <button type="button" class="pin" data-testid={`pin-panel-${id}`} title={t("layout.pin")} aria-label={`${t("layout.pin")}: ${t(`panel.${id}`)}`} onClick={() => changeLayout(store, pinPanel(store.state.layout))}>
          <Icon path={PIN_ICON} />
        </button>
        <SignButton sign="×" testid={`close-panel-${id}`} label={`${t("layout.close")}: ${t(`panel.${id}`)}`} title={t("layout.close")} press={close} />
      </header>
      {/* Focusable, so that the keyboard scrolls it. */}
      <div class="panel" data-testid={`panel-${id}`} role="group" tabindex={0} aria-labelledby={heading}>
        <Shown.Provider value={shown}>{exists.current && sections.map((Each, index) => <Each key={index} />)}</Shown.Provider>
      </div>
    </section>
  );
}
