import "./log.css";
import type { JSX } from "preact";
import { useLayoutEffect, useRef, useState } from "preact/hooks";
import { filteredLog, levelName, LOG_LEVELS, logLine } from "../logic/log-filter";
import type { LogEntry } from "../state/state";
import { t } from "../texts/texts";
import { copyText } from "./files";
import { Button, Line, Select, useSlowPart } from "./ui";

/** Distance from the end within which the list follows new lines [px]. */
const AT_END_PX = 8;

const COPIED_MS = 2000;

/** The server's log: filtered, the newest last, and still while one reads what is above. */
export function LogPanel(): JSX.Element {
  const log = useSlowPart((state) => state.log);
  const [level, setLevel] = useState("20");
  const [filter, setFilter] = useState("");
  // The log at the moment when it was halted; null while the list follows.
  const [halted, halt] = useState<LogEntry[] | null>(null);
  const [copied, setCopied] = useState("");
  const list = useRef<HTMLOListElement>(null);
  const entries = filteredLog(halted ?? log, Number(level), filter);
  const newest = filteredLog(log, Number(level), filter);
  const last = entries.at(-1);
  const newer = halted ? newest.length - 1 - (last ? newest.lastIndexOf(last) : -1) : 0;
  useLayoutEffect(() => {
    if (list.current && !halted) list.current.scrollTop = list.current.scrollHeight;
  });
  const onScroll = ({ currentTarget: { scrollHeight, scrollTop, clientHeight } }: { currentTarget: HTMLElement }): void => {
    const at_end = scrollHeight - scrollTop - clientHeight <= AT_END_PX;
    // A list that is being read stays still; at its end it goes on.
    if (at_end && halted) halt(null);
    else if (!at_end && !halted && scrollHeight > clientHeight) halt(log);
  };
  const copy = async (): Promise<void> => {
    setCopied(t((await copyText(entries.map(logLine).join("\n"))) ? "log.copied" : "log.not_copied"));
    setTimeout(() => setCopied(""), COPIED_MS);
  };
  return (
    <div class="log-panel" data-testid="section-log">
      <div class="buttons">
        <Line text={t("log.level")}><Select testid="log-level" value={level} options={LOG_LEVELS.map(([value, name]) => [String(value), t(`log.level.${name}`)])} take={setLevel} /></Line>
        <Line text={t("log.filter")}><input type="search" data-testid="log-filter" spellcheck={false} autocomplete="off" onInput={({ currentTarget }) => setFilter(currentTarget.value)} /></Line>
        <Button testid="log-pause" aria-pressed={halted !== null} press={() => halt(halted ? null : log)}>{halted ? `▶ ${t("log.resume")}` : `❚❚ ${t("log.pause")}`}</Button>
        <Button testid="log-copy" press={() => void copy()}>{copied || t("log.copy")}</Button>
      </div>
      <p class="hint" data-testid="log-empty" hidden={entries.length > 0}>{t(log.length === 0 ? "log.empty" : "log.empty.filtered")}</p>
      <ol ref={list} class="log" data-testid="log" aria-label={t("log.label")} aria-live="polite" tabindex={0} onScroll={onScroll}>
        {entries.map((entry) => <LogItem key={keyOf(entry)} entry={entry} />)}
      </ol>
      <Button testid="log-new" hidden={newer <= 0} press={() => halt(null)}>{t("log.new", { count: newer })}</Button>
    </div>
  );
}

const keys = new WeakMap<LogEntry, number>();
let last_key = 0;

/** Return a key that an entry keeps, so that a selection of its text stays while lines come and go. */
function keyOf(entry: LogEntry): number {
  const key = keys.get(entry) ?? ++last_key;
  keys.set(entry, key);
  return key;
}

function LogItem({ entry: { stamp, level, name, text } }: { entry: LogEntry }): JSX.Element {
  const kind = levelName(level);
  return <li data-level={kind}><time>{new Date(stamp * 1000).toLocaleTimeString()}</time>{` ${t(`log.level.${kind}`)} `}<span class="from">{name}</span>{` ${text}`}</li>;
}
