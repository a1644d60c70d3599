import type { LogEntry } from "../state/state";

export const LOG_LEVELS = [
  [10, "debug"],
  [20, "info"],
  [30, "warning"],
  [40, "error"],
] as const;
export type LogLevelName = (typeof LOG_LEVELS)[number][1];

export function levelName(level: number): LogLevelName {
  return LOG_LEVELS.findLast(([least]) => level >= least)?.[1] ?? "debug";
}

/** Return the entries from a level on that contain a text, in the message or the logger's name, whatever the case. */
export function filteredLog(entries: readonly LogEntry[], level: number, text: string): LogEntry[] {
  const wanted = text.trim().toLowerCase();
  return entries.filter((entry) => entry.level >= level && `${entry.name} ${entry.text}`.toLowerCase().includes(wanted));
}

export function logLine({ stamp, level, name, text }: LogEntry): string {
  return `${new Date(stamp * 1000).toISOString()} ${levelName(level)} ${name} ${text}`;
}
