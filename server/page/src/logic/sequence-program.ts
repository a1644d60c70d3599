import JAVASCRIPT from "./sequence-program.mjs.txt?raw";
import PYTHON from "./sequence-program.py.txt?raw";
import { GRIPPER_TYPE, type Waypoint } from "./sequence";

export interface Program {
  file: string;
  text: string;
}

export type ProgramLanguage = "python" | "javascript";

/** Return a program that plays a sequence over rosbridge; an argument of the program replaces the WebSocket address. */
export function sequenceProgram(
  language: ProgramLanguage,
  waypoints: readonly Waypoint[],
  url: string,
  gripper_action: string | null,
): Program {
  const python = language === "python";
  const literal = python ? pythonLiteral : (value: unknown): string => JSON.stringify(value);
  const indent = python ? "    " : "  ";
  const table = waypoints.map(({ id: _, ...waypoint }) => `${indent}${literal(waypoint)},`).join("\n");
  const values: Record<string, string> = {
    table,
    url: JSON.stringify(url),
    gripper: literal(gripper_action),
    gripper_type: JSON.stringify(GRIPPER_TYPE),
  };
  const text = (python ? PYTHON : JAVASCRIPT).replace(/<<(\w+)>>/g, (_, key: string) => values[key] ?? "");
  return { file: python ? "sequence.py" : "sequence.mjs", text };
}

/** Return a value as Python writes it: a text of JSON is one of Python as well. */
function pythonLiteral(value: unknown): string {
  if (value === null) return "None";
  if (typeof value === "boolean") return value ? "True" : "False";
  if (typeof value !== "object") return JSON.stringify(value);
  const pairs = Object.entries(value).map(([key, part]) => `${JSON.stringify(key)}: ${pythonLiteral(part)}`);
  return `{${pairs.join(", ")}}`;
}
