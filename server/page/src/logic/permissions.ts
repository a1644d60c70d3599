import type { State } from "../state/state";

/** Operations with a permission of their own: moving the arm, changing its scene, changing stored settings. */
export type Operation = "drive" | "work" | "configure";

/** Parts of the state that permissions depend on. */
type PermissionState = Pick<State, "identity" | "control">;

const ROLES = ["view", "operate", "admin"];
const NEEDED_ROLE: Record<Operation, string> = { drive: "operate", work: "operate", configure: "admin" };

/** Return the server's reason to deny an operation, as a sentence; empty when it is allowed, or not yet known. */
export function denialReason(operation: Operation, { identity, control }: PermissionState): string {
  if (!identity) return "";
  const needed = NEEDED_ROLE[operation];
  if (ROLES.indexOf(identity.role) < ROLES.indexOf(needed)) {
    return `This page has the role ${identity.role}: for this it needs a token with the role ${needed}.`;
  }
  const another = operation === "drive" && controlHolder({ identity, control }) === "another";
  return another ? `${control.holder} controls the arm.` : "";
}

/** Return the holder of control as seen from this page. */
export function controlHolder({ identity, control }: PermissionState): "nobody" | "this page" | "another" {
  if (control.policy === "shared" || control.holder === "") return "nobody";
  return identity?.address === control.address ? "this page" : "another";
}

/** Return the sentence about control of the arm; empty where all clients share it. */
export function controlText(state: PermissionState): string {
  const { identity, control } = state;
  const sentences = {
    nobody: "Nobody controls the arm.",
    "this page": "This page controls the arm.",
    another: heldByAnother(control),
  };
  const sentence = control.policy === "shared" ? "" : sentences[controlHolder(state)];
  if (identity?.role !== "view") return sentence;
  return `Read only: the role view lets this page look, and stop the arm. ${sentence}`.trim();
}

function heldByAnother({ holder: name, free_in_s }: State["control"]): string {
  if (free_in_s === null) return `${name} controls the arm.`;
  return `${name} controls the arm. It is free in ${free_in_s} s if nothing more is asked of it.`;
}
