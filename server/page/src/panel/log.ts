import "./log.css";
import { filteredLog, levelName, LOG_LEVELS, logLine } from "../logic/log-filter";
import type { LogEntry, State } from "../state/state";
import { t } from "../texts/texts";
import { isShown, whenShown } from "./dock";
import { button, el, labelled, option, setText, throttle } from "./dom";
import type { PanelContext } from "./context";
import { copyText } from "./files";

/** Time between two updates [ms]. */
const UPDATE_PERIOD_MS = 200;

/** Distance from the end within which the list follows new lines [px]. */
const AT_END_PX = 8;

/** Time that the answer stays on the button for copying [ms]. */
const COPIED_MS = 2000;

/** Create the server's log: filtered, the newest last, and still while one reads what is above. */
export function logSection(context: PanelContext): HTMLElement {
  return new LogPanel(context).element;
}

/** List of log entries that follows the newest until it is halted, or scrolled up. */
class LogPanel {
  readonly element: HTMLElement;
  private following = true;
  private shown: LogEntry[] = [];
  private readonly level = el("select", { testid: "log-level" });
  private readonly filter = el("input", { type: "search", testid: "log-filter", attributes: { spellcheck: "false", autocomplete: "off" } });
  private readonly list = el("ol", { class: "log", testid: "log", label: t("log.label"), attributes: { "aria-live": "polite" } });
  private readonly empty = el("p", { class: "hint", testid: "log-empty" });
  private readonly halt = button("", "log-pause", () => this.follow(!this.following));
  private readonly newer = button("", "log-new", () => this.follow(true));
  private readonly copy = button(t("log.copy"), "log-copy", () => void this.copyShown());
  private readonly request = throttle<State>(UPDATE_PERIOD_MS, (state) => this.show(state));

  constructor(private readonly context: PanelContext) {
    const { store } = context;
    for (const [level, name] of LOG_LEVELS) {
      this.level.append(option(String(level), t(`log.level.${name}`)));
    }
    this.level.value = "20";
    this.list.tabIndex = 0;
    const choices = el("div", { class: "buttons" }, labelled(t("log.level"), this.level), labelled(t("log.filter"), this.filter), this.halt, this.copy);
    this.element = el("div", { class: "log-panel", testid: "section-log" }, choices, this.empty, this.list, this.newer);
    this.level.addEventListener("change", () => this.fill());
    this.filter.addEventListener("input", () => this.fill());
    this.list.addEventListener("scroll", () => this.onScroll());
    store.subscribe((state) => state.log, (_, state) => this.request(state));
    whenShown(this.list, () => this.request(store.state));
    this.showTools(0);
  }

  private get entries(): LogEntry[] {
    return filteredLog(this.context.store.state.log, Number(this.level.value), this.filter.value);
  }

  private follow(on: boolean): void {
    this.following = on;
    if (on) this.fill();
    else this.showTools(0);
  }

  private onScroll(): void {
    const { scrollHeight, scrollTop, clientHeight } = this.list;
    const at_end = scrollHeight - scrollTop - clientHeight <= AT_END_PX;
    // A list that is being read stays still; at its end it goes on.
    if (at_end !== this.following && (at_end || scrollHeight > clientHeight)) this.follow(at_end);
  }

  private show(_state: State): void {
    if (!isShown(this.list)) return;
    if (this.following) return this.fill();
    const last = this.shown.at(-1);
    const entries = this.entries;
    this.showTools(entries.length - 1 - (last ? entries.lastIndexOf(last) : -1));
  }

  /** Show the entries as they are now, with the newest in sight. */
  private fill(): void {
    const entries = this.entries;
    const kept = this.shown.indexOf(entries[0] as LogEntry);
    const before = kept < 0 ? [] : this.shown.slice(kept);
    // Lines that stay are left alone, so that a selection of their text stays too.
    if (kept >= 0 && before.every((entry, index) => entry === entries[index])) {
      for (let index = 0; index < kept; index += 1) this.list.firstElementChild?.remove();
      this.list.append(...entries.slice(before.length).map(logItem));
    } else this.list.replaceChildren(...entries.map(logItem));
    this.shown = entries;
    setText(this.empty, t(this.context.store.state.log.length === 0 ? "log.empty" : "log.empty.filtered"));
    this.empty.hidden = entries.length > 0;
    if (this.following) this.list.scrollTop = this.list.scrollHeight;
    this.showTools(0);
  }

  private showTools(newer: number): void {
    setText(this.halt, this.following ? `❚❚ ${t("log.pause")}` : `▶ ${t("log.resume")}`);
    this.halt.setAttribute("aria-pressed", String(!this.following));
    setText(this.newer, t("log.new", { count: newer }));
    this.newer.hidden = this.following || newer <= 0;
  }

  private async copyShown(): Promise<void> {
    const copied = await copyText(this.shown.map(logLine).join("\n"));
    setText(this.copy, t(copied ? "log.copied" : "log.not_copied"));
    setTimeout(() => setText(this.copy, t("log.copy")), COPIED_MS);
  }
}

function logItem(entry: LogEntry): HTMLElement {
  const level = levelName(entry.level);
  const time = el("time", { text: new Date(entry.stamp * 1000).toLocaleTimeString() });
  const item = el("li", {}, time, ` ${t(`log.level.${level}`)} `, el("span", { class: "from", text: entry.name }), ` ${entry.text}`);
  item.dataset["level"] = level;
  return item;
}
