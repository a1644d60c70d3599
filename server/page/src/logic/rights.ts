import type { State } from "../state/state";

/** What the server wants a right for: to drive the arm, to change what is around it, to change what stays. */
export type Deed = "drive" | "work" | "configure";

type RightsInput = Pick<State, "identity" | "control">;

const ROLES = ["view", "operate", "admin"];
const NEEDED: Record<Deed, string> = { drive: "operate", work: "operate", configure: "admin" };

/** Why the server would refuse this page something, as a sentence; empty when it would not, or that is not known. */
export function hindrance(deed: Deed, { identity, control }: RightsInput): string {
  if (!identity) return "";
  const needed = NEEDED[deed];
  if (ROLES.indexOf(identity.role) < ROLES.indexOf(needed)) {
    return `This page has the role ${identity.role}: for this it needs a token with the role ${needed}.`;
  }
  const another = deed === "drive" && holder({ identity, control }) === "another";
  return another ? `${control.holder} controls the arm.` : "";
}

/** Who drives the arm, as seen from this page. */
export function holder({ identity, control }: RightsInput): "nobody" | "this page" | "another" {
  if (control.policy === "shared" || control.holder === "") return "nobody";
  return identity?.address === control.address ? "this page" : "another";
}

/** What the user reads about who drives; empty where all may at once. */
export function controlSentence(state: RightsInput): string {
  const { identity, control } = state;
  const drives = { nobody: "Nobody controls the arm.", "this page": "This page controls the arm.", another: waiting(control) };
  const who = control.policy === "shared" ? "" : drives[holder(state)];
  if (identity?.role !== "view") return who;
  return `Read only: the role view lets this page look, and stop the arm. ${who}`.trim();
}

function waiting({ holder: name, free_in_s }: State["control"]): string {
  if (free_in_s === null) return `${name} controls the arm.`;
  return `${name} controls the arm. It is free in ${free_in_s} s if nothing more is asked of it.`;
}
