import type { State } from "../state/state";
import { PREEMPTED, SUCCESS, codeName } from "./codes";

/** What the state pill shows. */
export interface Pill {
  label: string;
  /** Chooses the colour. */
  kind: "idle" | "busy" | "stopped" | "fault" | "off";
}

type PillInput = Pick<State, "link" | "arm" | "goal" | "asked">;

/** The arm's state in a word. */
export function pill({ link, arm, goal, asked }: PillInput): Pill {
  if (!link.connected) return { label: "OFFLINE", kind: "off" };
  if (arm.mode === "fault") return { label: "FAULT", kind: "fault" };
  if (arm.mode === "disconnected") return { label: "NO ARM", kind: "fault" };
  if (arm.mode === "connected") return { label: "CHECKING", kind: "off" };
  if (goal.state === "executing" || arm.mode === "moving") return { label: moving(arm.course), kind: "busy" };
  if (goal.state === "planning" || asked === "plan") return { label: "PLANNING", kind: "busy" };
  if (arm.mode === "relaxed") return { label: "RELAXED", kind: "off" };
  if (goal.state === "done" && goal.code === PREEMPTED) return { label: "STOPPED", kind: "stopped" };
  return { label: "IDLE", kind: "idle" };
}

function moving(course: string): string {
  return { paused: "PAUSED", back: "GOING BACK" }[course] ?? "EXECUTING";
}

/** The sentence below the pill: a fault with its remedy, else how the last goal ended or goes. */
export function sentence({ link, arm, goal }: PillInput): string {
  if (link.refused) return "The server wants a token.";
  if (!link.connected) return "The server cannot be reached; the page keeps trying. What is shown is old.";
  if (arm.mode === "fault") return `${arm.fault}: ${ended(arm.fault_message)} ${ended(arm.fault_remedy)}`.trim();
  if (arm.mode === "disconnected" || arm.mode === "connected") return arm.message;
  if (goal.state === "done" && goal.code !== null && goal.code !== SUCCESS) {
    return `${codeName(goal.code)} (${goal.code}): ${goal.message}`;
  }
  if (arm.mode === "relaxed") return arm.message;
  return goal.message || arm.message;
}

function ended(text: string): string {
  return text === "" || /[.!?]$/.test(text) ? text : `${text}.`;
}
