import { closePanel, columnOf, COLUMNS, movePanel, openPanel, parseLayout, type Column, type Layout } from "../logic/layout";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { button, el, loadPreference, option, storePreference } from "./dom";

/** Panel of the dock; its sections exist from the start, also while it is closed. */
export interface Panel {
  id: string;
  title: string;
  sections: HTMLElement[];
}

/** Dispatched at a panel's element when it comes into sight. */
const SHOWN = "panel-shown";

/** Return true while an element can be seen: its panel is the shown one of its column, and no section above it is closed. */
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

/** Columns of panels beside the arm; each shows one of its panels, chosen by tabs, and the browser stores the layout. */
export class Dock {
  private readonly columns: Record<Column, HTMLElement>;
  private readonly tabs: Record<Column, HTMLElement>;
  private readonly tab_of = new Map<string, HTMLElement>();
  private readonly updateTools: Record<Column, () => void> = { first: () => undefined, second: () => undefined };
  private readonly empty: Record<Column, HTMLElement> = {
    first: el("p", { class: "hint empty", text: t("layout.empty") }),
    second: el("p", { class: "hint empty", text: t("layout.empty") }),
  };
  private readonly hosts = new Map<string, HTMLElement>();

  /**
   * @param host - element of the page that gets the columns.
   * @param panels - all panels.
   * @param store - holds the layout.
   */
  constructor(
    host: HTMLElement,
    private readonly panels: readonly Panel[],
    private readonly store: PageStore,
  ) {
    const ids = panels.map(({ id }) => id);
    const created = COLUMNS.map((column) => [column, ...this.createColumn(column)] as const);
    this.columns = Object.fromEntries(created.map(([column, element]) => [column, element])) as Record<Column, HTMLElement>;
    this.tabs = Object.fromEntries(created.map(([column, , tabs]) => [column, tabs])) as Record<Column, HTMLElement>;
    for (const { id, sections } of panels) {
      const attributes = { tabindex: "0", "aria-labelledby": `tab-${id}` };
      const options = { class: "panel", id: `panel-${id}`, testid: `panel-${id}`, role: "tabpanel", attributes };
      this.hosts.set(id, el("section", options, ...sections));
    }
    host.setAttribute("aria-label", t("layout.panels"));
    host.append(...COLUMNS.map((column) => this.columns[column]));
    store.set({ layout: parseLayout(loadPreference("layout", ""), ids, store.state.layout) });
    store.subscribe(
      (state) => state.layout,
      (layout) => {
        storePreference("layout", JSON.stringify({ ...layout, known: ids }));
        this.show();
      },
    );
  }

  private get layout(): Layout {
    return this.store.state.layout;
  }

  private change(layout: Layout): void {
    this.store.set({ layout });
  }

  private createColumn(column: Column): [HTMLElement, HTMLElement] {
    const tabs = el("div", { class: "tabs", role: "tablist", label: t("layout.panels") });
    tabs.addEventListener("keydown", (event) => this.onKey(event, column));
    const element = el("div", { class: "column", testid: `column-${column}`, attributes: { "data-column": column } });
    element.append(el("div", { class: "tab-bar" }, tabs, this.createTools(column)), this.empty[column]);
    return [element, tabs];
  }

  private show(): void {
    for (const column of COLUMNS) this.showColumn(column);
    for (const [id, host] of this.hosts) {
      const column = columnOf(this.layout, id);
      const shown = column !== null && this.layout.shown[column] === id;
      // Closed ones too: what updates the whole page finds them in the document.
      const parent = this.columns[column ?? "first"];
      if (host.parentElement !== parent) parent.append(host);
      if (host.hidden === !shown) continue;
      host.hidden = !shown;
      if (shown) host.dispatchEvent(new Event(SHOWN, { bubbles: true }));
    }
  }

  private showColumn(column: Column): void {
    const ids = this.layout.panels[column];
    // The first column stays, so that there is a place to open panels from.
    this.columns[column].hidden = column === "second" && ids.length === 0;
    const host = this.tabs[column];
    const tabs = ids.map((id) => this.tabOf(id));
    // Tabs that stay where they are keep the focus.
    if (tabs.length !== host.children.length || tabs.some((tab, index) => host.children[index] !== tab)) host.replaceChildren(...tabs);
    for (const [index, tab] of tabs.entries()) {
      const selected = this.layout.shown[column] === ids[index];
      if (selected && tab.getAttribute("aria-selected") !== "true") requestAnimationFrame(() => tab.scrollIntoView({ block: "nearest", inline: "nearest" }));
      tab.setAttribute("aria-selected", String(selected));
      tab.tabIndex = selected ? 0 : -1;
    }
    this.updateTools[column]();
    this.empty[column].hidden = ids.length > 0;
  }

  private tabOf(id: string): HTMLElement {
    const known = this.tab_of.get(id);
    if (known) return known;
    const tab = button(this.titleOf(id), `tab-${id}`, () => this.change(openPanel(this.layout, id)));
    tab.id = `tab-${id}`;
    tab.setAttribute("role", "tab");
    tab.setAttribute("aria-controls", `panel-${id}`);
    this.tab_of.set(id, tab);
    return tab;
  }

  /** Create the buttons that open, move and close panels of a column. */
  private createTools(column: Column): HTMLElement {
    const choice = el("select", { class: "add-panel", testid: `open-panel-${column}`, label: t("layout.open") });
    choice.title = t("layout.open");
    choice.addEventListener("change", () => choice.value !== "" && this.openIn(choice.value, column));
    const other = t(column === "first" ? "layout.to_second" : "layout.to_first");
    const shown = (): string => this.layout.shown[column];
    const move = button(column === "first" ? "⇤" : "⇥", `move-panel-${column}`, () => this.moveShown(shown()), other);
    const close = button("×", `close-panel-${column}`, () => this.closeShown(shown(), column), t("layout.close"));
    move.classList.add("to-column");
    move.setAttribute("aria-label", other);
    close.setAttribute("aria-label", t("layout.close"));
    let offered = "";
    this.updateTools[column] = () => {
      const closed = this.panels.filter(({ id }) => columnOf(this.layout, id) === null);
      const key = closed.map(({ id }) => id).join();
      if (key !== offered || choice.options.length === 0) {
        choice.replaceChildren(option("", "+"));
        choice.append(...closed.map(({ id, title }) => option(id, title)));
        offered = key;
      }
      choice.hidden = closed.length === 0;
      move.disabled = close.disabled = shown() === "";
    };
    return el("div", { class: "tab-tools" }, choice, move, close);
  }

  private moveShown(id: string): void {
    this.change(movePanel(this.layout, id));
    this.tabOf(id).focus();
  }

  private closeShown(id: string, column: Column): void {
    this.change(closePanel(this.layout, id));
    const next = this.layout.shown[column] || this.layout.shown.first;
    if (next !== "") this.tabOf(next).focus();
  }

  private openIn(id: string, column: Column): void {
    const opened = openPanel(this.layout, id);
    this.change(column === "first" ? opened : movePanel(opened, id));
    this.tabOf(id).focus();
  }

  /** Arrow keys, Home and End go through the tabs, Delete closes one, as ARIA's pattern for tabs has it. */
  private onKey(event: KeyboardEvent, column: Column): void {
    const ids = this.layout.panels[column];
    const now = ids.indexOf(this.layout.shown[column]);
    const index = { ArrowRight: now + 1, ArrowLeft: now - 1, Home: 0, End: -1 }[event.key];
    if (event.key === "Delete") this.closeShown(this.layout.shown[column], column);
    if (index === undefined || ids.length === 0) return;
    const next = ids.at(index % ids.length) ?? "";
    this.change(openPanel(this.layout, next));
    this.tabOf(next).focus();
    event.preventDefault();
  }

  private titleOf(id: string): string {
    return this.panels.find((panel) => panel.id === id)?.title ?? id;
  }
}
