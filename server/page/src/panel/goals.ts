import "./goals.css";
import type { GoalRecord } from "../link/goal-history";
import { errorCodeName, PREEMPTED, SUCCESS } from "../link/messages";
import { goalKind, readAsked, type GoalEntry } from "../logic/goal-history";
import { noPlan, type ActiveGoal, type GoalState } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { isShown, whenShown } from "./dock";
import { button, el, keyedList, section, setText, throttle, type ListItem } from "./dom";
import { saveFile } from "./files";

/** Time between two updates [ms]; a goal in progress has several statuses a second. */
const UPDATE_PERIOD_MS = 250;

/** Newest goals that say where they were to go: each takes a request. */
const MAX_PLACES = 20;

/** Create the list of active goals, of all clients. */
export function activeGoalsSection({ store, stopCommand, commands }: PanelContext): HTMLElement {
  const list = el("ol", { class: "things", testid: "waiting" });
  const empty = el("p", { class: "hint", text: t("goals.active.empty") });
  const all = button(t("goals.cancel_all"), "cancel-all", () => void stopCommand.stop(), t("goals.cancel_all.title"));
  const box = section("waiting", t("goals.active"), true, empty, list, all);
  const show = keyedList<ActiveGoal>(list, ({ id }) => id, ({ id }) => activeItem(id, () => commands.cancelGoal(id)));
  store.subscribe(
    (state) => state.active_goals,
    (goals) => {
      show(goals);
      empty.hidden = goals.length > 0;
      all.disabled = goals.length === 0;
    },
  );
  return box;
}

function activeItem(id: string, cancel: () => void): ListItem<ActiveGoal> {
  const text = el("span");
  const press = button(t("goals.cancel"), `cancel-${id}`, cancel);
  const show = ({ name, state }: ActiveGoal): void => {
    setText(text, itemText(id, name, stateText(state)));
    press.setAttribute("aria-label", `${t("goals.cancel")}: ${text.textContent}`);
  };
  return { element: el("li", { testid: `waiting-${id}` }, text, press), show };
}

/** Goal of the timeline with where it was to go, once the server has told it. */
interface ListedGoal {
  entry: GoalEntry;
  place: string;
}

/** Create the timeline of goals, newest first, each of which opens its record. */
export function goalsSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("ol", { class: "timeline", testid: "goal-history" });
  const empty = el("p", { class: "hint", testid: "goal-history-empty", text: t("goals.empty") });
  const box = section("goal-history", t("goals.history"), true, empty, list);
  const showItems = keyedList<ListedGoal>(list, ({ entry }) => keyOf(entry), ({ entry }) => new GoalItem(context, entry));
  const places = new Map<string, string>();
  let is_asking = false;
  const askNext = async (newest: readonly GoalEntry[]): Promise<void> => {
    const entry = newest.slice(0, MAX_PLACES).find((each) => each.goal.state === "done" && !places.has(keyOf(each)));
    if (is_asking || entry === undefined) return;
    is_asking = true;
    const record = await context.goalRecord(entry.goal.id);
    is_asking = false;
    places.set(keyOf(entry), typeof record === "string" ? "" : (askedText(record.asked, context) ?? ""));
    show(store.state.goal_history);
  };
  const show = throttle<readonly GoalEntry[]>(UPDATE_PERIOD_MS, (history) => {
    if (!isShown(list)) return;
    const newest = history.toReversed();
    const keys = new Set(newest.map(keyOf));
    for (const key of places.keys()) if (!keys.has(key)) places.delete(key);
    empty.hidden = history.length > 0;
    showItems(newest.map((entry) => ({ entry, place: places.get(keyOf(entry)) ?? "" })));
    void askNext(newest);
  });
  store.subscribe((state) => state.goal_history, show);
  whenShown(list, () => show(store.state.goal_history));
  return box;
}

/** A server that was started anew gives the same numbers to other goals. */
function keyOf({ goal, began_s }: GoalEntry): string {
  return `${goal.id} ${goal.source} ${began_s}`;
}

/** Goal of the timeline with its record, which is fetched when it is opened. */
class GoalItem implements ListItem<ListedGoal> {
  readonly element: HTMLElement;
  private readonly details = el("details", { class: "goal" });
  private readonly time = el("time");
  private readonly title = el("span");
  private readonly body = el("div", { class: "goal-body" });
  private shown: GoalEntry | null = null;

  constructor(private readonly context: PanelContext, { goal }: GoalEntry) {
    this.details.append(el("summary", { testid: `goal-open-${goal.id}` }, this.time, " ", this.title), this.body);
    this.details.addEventListener("toggle", () => this.details.open && void this.fill());
    this.element = el("li", { testid: `goal-${goal.id}` }, this.details);
  }

  show({ entry, place }: ListedGoal): void {
    const { goal, began_s } = entry;
    setText(this.title, itemText(goal.id, goal.source, outcomeText(goal), place));
    if (entry === this.shown) return;
    const was_done = this.shown?.goal.state === "done";
    this.shown = entry;
    setText(this.time, new Date(began_s * 1000).toLocaleTimeString());
    this.element.dataset["outcome"] = outcomeOf(goal);
    if (this.details.open && goal.state === "done" && !was_done) void this.fill();
  }

  private async fill(): Promise<void> {
    const entry = this.shown;
    if (entry === null) return;
    if (entry.goal.state !== "done") return this.body.replaceChildren(el("p", { text: entry.goal.message }));
    if (this.body.childElementCount === 0) this.body.replaceChildren(el("p", { class: "hint", text: t("goals.loading") }));
    const record = await this.context.goalRecord(entry.goal.id);
    if (this.shown === entry) this.body.replaceChildren(...this.contents(entry.goal, record));
  }

  private contents(goal: GoalState, record: GoalRecord | string): HTMLElement[] {
    const facts = el("dl", { class: "facts" });
    const add = (title: TextKey, text: string, ...more: Node[]): void => facts.append(el("dt", { text: t(title) }), el("dd", { text }, ...more));
    const known = typeof record === "string" ? null : record;
    if (known) this.addAsked(add, known);
    if (known) add("goals.found", foundText(known));
    add("goals.answer", `${goal.message} (${errorCodeName(goal.code ?? 0)})`);
    if (goal.suggestion) add("goals.works", askedText(JSON.stringify(goal.suggestion.msg), this.context) ?? goal.suggestion.topic);
    const remark = known ? known.message : String(record);
    const tools = el("div", { class: "buttons" }, ...this.tools(goal, known));
    return [facts, tools, ...(remark ? [el("p", { class: "hint", text: remark })] : [])];
  }

  private addAsked(add: (title: TextKey, text: string, ...more: Node[]) => void, { asked }: GoalRecord): void {
    const whole = el("details", {}, el("summary", { text: t("goals.asked.raw") }), el("pre", { text: asked }));
    add("goals.asked", askedText(asked, this.context) ?? "", whole);
  }

  private tools(goal: GoalState, record: GoalRecord | null): HTMLElement[] {
    const tools: HTMLElement[] = [];
    const { store, commands } = this.context;
    const plan = record?.plan;
    if (plan) {
      const ghost = button(t("goals.ghost"), `goal-ghost-${goal.id}`, () => {
        store.set({ plan: { ...noPlan(), trajectory: plan, scrub_s: 0 } });
        store.patch("plan", { replaying: true });
      });
      tools.push(ghost);
    }
    if (record && record.problem !== "") {
      const save = (): void => saveFile(record.problem_name, "application/json", record.problem);
      tools.push(button(t("goals.save"), `goal-save-${goal.id}`, save, t("goals.save.title")));
    }
    const { suggestion } = goal;
    if (suggestion) {
      const instead = button(t("goals.instead"), `goal-instead-${goal.id}`, () => commands.publishSuggestion(suggestion));
      tools.push(permissionFieldset(this.context, "drive", instead));
    }
    return tools;
  }
}

function itemText(id: string, source: string, outcome: string, place = ""): string {
  return t("goals.item", { id, what: place || t(`goals.by.${goalKind(source)}`, { source }), outcome });
}

function stateText(state: string): string {
  const key = `goals.state.${state}`;
  return ["queued", "planning", "planned", "executing", "done"].includes(state) ? t(key as TextKey) : state;
}

type Outcome = "open" | "done" | "stopped" | "failed";

function outcomeOf({ state, code }: GoalState): Outcome {
  if (state !== "done") return "open";
  return code === SUCCESS ? "done" : code === PREEMPTED ? "stopped" : "failed";
}

function outcomeText(goal: GoalState): string {
  const outcome = outcomeOf(goal);
  return outcome === "open" ? stateText(goal.state) : t(`goals.${outcome}`);
}

function foundText({ plan, duration_s, planning_time_s, summary }: GoalRecord): string {
  if (!plan) return t("goals.found.nothing");
  const parts = [t("goals.found.plan", { duration: duration_s.toFixed(1) })];
  if (planning_time_s > 0) parts.push(t("goals.found.planning", { planning: Math.max(1, Math.round(planning_time_s * 1000)) }));
  return summary ? `${parts.join(", ")} (${summary})` : parts.join(", ");
}

function askedText(json: string, { store }: PanelContext): string | null {
  const asked = readAsked(json, store.state);
  if (asked === null) return null;
  if (asked.kind === "named") return t("goals.asked.named", { name: asked.name });
  if (asked.kind === "joints") return t("goals.asked.joints", { joints: asked.text });
  const [x = "", y = "", z = ""] = asked.point;
  return t("goals.asked.point", { x, y, z, unit: asked.unit });
}
