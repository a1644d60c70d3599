import "./goals.css";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { fetchGoalRecord, type GoalRecord } from "../link/goal-history";
import { errorCodeName, PREEMPTED, SUCCESS } from "../link/messages";
import { goalKind, readAsked, type GoalEntry } from "../logic/goal-history";
import { inUnits } from "../logic/numbers";
import { NO_PLAN, type ActiveGoal, type GoalState, type State } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { saveFile } from "./files";
import { Button, Gate, Section, usePage, useSlowPart } from "./ui";

/** Newest goals that say where they were to go: each takes a request. */
const MAX_PLACES = 20;

export function ActiveGoals(): JSX.Element {
  const { store, stopCommand } = usePage();
  const goals = store.state.active_goals;
  return (
    <Section name="waiting" title={t("goals.active")}>
      <p class="hint" hidden={goals.length > 0}>{t("goals.active.empty")}</p>
      <ol class="things" data-testid="waiting">{goals.map((goal) => <ActiveItem key={goal.id} {...goal} />)}</ol>
      <Button testid="cancel-all" title={t("goals.cancel_all.title")} disabled={goals.length === 0} press={() => void stopCommand.stop()}>{t("goals.cancel_all")}</Button>
    </Section>
  );
}

function ActiveItem({ id, name, state }: ActiveGoal): JSX.Element {
  const { commands } = usePage();
  const text = itemText(id, name, stateText(state));
  return (
    <li data-testid={`waiting-${id}`}>
      <span>{text}</span>
      <Button testid={`cancel-${id}`} aria-label={`${t("goals.cancel")}: ${text}`} press={() => commands.decide(id, "cancel")}>{t("goals.cancel")}</Button>
    </li>
  );
}

export function GoalHistory(): JSX.Element {
  const { connection, store } = usePage();
  const history = useSlowPart((state) => state.goal_history);
  const [places, setPlaces] = useState<Record<string, string>>({});
  const newest = history.toReversed();
  const next = newest.slice(0, MAX_PLACES).find((entry) => entry.goal.state === "done" && !(keyOf(entry) in places));
  const next_key = next && keyOf(next);
  // One request at a time: each answer asks for the next one.
  useEffect(() => {
    if (next === undefined || next_key === undefined) return;
    void fetchGoalRecord(connection, next.goal.id).then((record) => {
      const place = typeof record === "string" ? "" : (askedText(record.asked, store.state) ?? "");
      const keys = new Set(store.state.goal_history.map(keyOf));
      setPlaces((known) => ({ ...Object.fromEntries(Object.entries(known).filter(([key]) => keys.has(key))), [next_key]: place }));
    });
  }, [next_key]);
  return (
    <Section name="goal-history" title={t("goals.history")}>
      <p class="hint" data-testid="goal-history-empty" hidden={newest.length > 0}>{t("goals.empty")}</p>
      <ol class="timeline" data-testid="goal-history">
        {newest.map((entry) => <GoalItem key={keyOf(entry)} entry={entry} place={places[keyOf(entry)] ?? ""} />)}
      </ol>
    </Section>
  );
}

/** Return a key that differs also from goals before a restart of the server, which counts from 1 again. */
function keyOf({ goal, began_s }: GoalEntry): string {
  return `${goal.id} ${goal.source} ${began_s}`;
}

function GoalItem({ entry: { goal, began_s }, place }: { entry: GoalEntry; place: string }): JSX.Element {
  const { connection } = usePage();
  const [open, setOpen] = useState(false);
  const [record, setRecord] = useState<GoalRecord | string | null>(null);
  const is_done = goal.state === "done";
  useEffect(() => {
    if (open && is_done) void fetchGoalRecord(connection, goal.id).then(setRecord);
  }, [open, is_done]);
  return (
    <li data-testid={`goal-${goal.id}`}>
      <details class="goal" data-outcome={outcomeOf(goal)} onToggle={({ currentTarget }) => setOpen(currentTarget.open)}>
        <summary data-testid={`goal-open-${goal.id}`}>
          <time>{new Date(began_s * 1000).toLocaleTimeString()}</time> <span>{itemText(goal.id, goal.source, outcomeText(goal), place)}</span>
        </summary>
        <div class="goal-body">
          {!is_done ? <p>{goal.message}</p> : record === null ? <p class="hint">{t("goals.loading")}</p> : <Facts goal={goal} record={record} />}
        </div>
      </details>
    </li>
  );
}

function Facts({ goal, record }: { goal: GoalState; record: GoalRecord | string }): JSX.Element {
  const { store, commands } = usePage();
  const { suggestion } = goal;
  const known = typeof record === "string" ? null : record;
  const remark = known ? known.message : String(record);
  const replay = (): void => store.set({ plan: { ...NO_PLAN, trajectory: known?.plan ?? null, scrub_s: 0, replaying: true } });
  return (
    <>
      <dl class="facts">
        {known && <><dt>{t("goals.asked")}</dt><dd>{askedText(known.asked, store.state) ?? ""}</dd></>}
        {known && <details><summary>{t("goals.asked.raw")}</summary><pre>{known.asked}</pre></details>}
        {known && <><dt>{t("goals.found")}</dt><dd>{known.summary || t("goals.found.nothing")}</dd></>}
        <dt>{t("goals.answer")}</dt><dd>{`${inUnits(goal.message, store.state.settings.units)} (${errorCodeName(goal.code ?? 0)})`}</dd>
        {suggestion && <><dt>{t("goals.works")}</dt><dd>{askedText(JSON.stringify(suggestion.msg), store.state) ?? suggestion.topic}</dd></>}
      </dl>
      <div class="buttons">
        {known?.plan && <Button testid={`goal-ghost-${goal.id}`} press={replay}>{t("goals.ghost")}</Button>}
        {known && known.problem !== "" && (
          <Button testid={`goal-save-${goal.id}`} title={t("goals.save.title")} press={() => saveFile(known.problem_name, "application/json", known.problem)}>{t("goals.save")}</Button>
        )}
        {suggestion && <Gate to="drive"><Button testid={`goal-instead-${goal.id}`} press={() => commands.publish(suggestion.topic, suggestion.type, suggestion.msg)}>{t("goals.instead")}</Button></Gate>}
      </div>
      {remark && <p class="hint">{remark}</p>}
    </>
  );
}

function itemText(id: string, source: string, outcome: string, place = ""): string {
  return t("goals.item", { id, what: place || t(`goals.by.${goalKind(source)}`, { source }), outcome });
}

function stateText(state: string): string {
  return ["queued", "planning", "planned", "executing", "done"].includes(state) ? t(`goals.state.${state}` as TextKey) : state;
}

function outcomeOf({ state, code }: GoalState): "open" | "done" | "stopped" | "failed" {
  if (state !== "done") return "open";
  return code === SUCCESS ? "done" : code === PREEMPTED ? "stopped" : "failed";
}

function outcomeText(goal: GoalState): string {
  const outcome = outcomeOf(goal);
  return outcome === "open" ? stateText(goal.state) : t(`goals.${outcome}`);
}

export function askedText(json: string, state: State): string | null {
  const asked = readAsked(json, state);
  if (asked === null) return null;
  if (asked.kind === "named") return t("goals.asked.named", { name: asked.name });
  if (asked.kind === "joints") return t("goals.asked.joints", { joints: asked.text });
  const [x = "", y = "", z = ""] = asked.point;
  return t("goals.asked.point", { x, y, z, unit: asked.unit });
}
