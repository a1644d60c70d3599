import type { State } from "../state/state";
import { t } from "../texts/texts";
import { planningGroup, type KnownGroup } from "./robot-info";

/** Operations with a permission of their own: moving the arm, changing its scene, changing stored settings, calibrating. */
export type Operation = "drive" | "work" | "configure" | "commission";

type PermissionState = Pick<State, "identity" | "control">;

const ROLES = ["view", "propose", "operate", "admin"];
const NEEDED_ROLE: Record<Operation, string> = { drive: "operate", work: "operate", configure: "admin", commission: "admin" };

const NEEDS_LEASE: readonly Operation[] = ["drive", "commission"];

/** Return the server's reason to deny an operation, as a sentence; empty when it is allowed, or not yet known. */
export function denialReason(operation: Operation, { identity, control }: PermissionState): string {
  if (!identity) return "";
  const needed = NEEDED_ROLE[operation];
  if (ROLES.indexOf(identity.role) < ROLES.indexOf(needed)) {
    return t("denied.role", { role: identity.role, needed });
  }
  const another = NEEDS_LEASE.includes(operation) && controlHolder({ identity, control }) === "another";
  return another ? t("control.another", { name: control.holder }) : "";
}

/** Return the reason why the planning group's arm follows no command now; empty when it does, or where several have one state. */
export function immobility(state: KnownGroup & Pick<State, "arm">): string {
  const { mode, message } = state.arm;
  if (planningGroup(state)?.namespace || ["", "holding", "moving"].includes(mode)) return "";
  return mode === "relaxing" || mode === "relaxed" ? t(`status.${mode}`) : message;
}

/** Return the holder of control as seen from this page. */
export function controlHolder({ identity, control }: PermissionState): "nobody" | "mine" | "another" {
  if (control.policy === "shared" || control.holder === "") return "nobody";
  return identity?.address === control.address ? "mine" : "another";
}

export function controlText(state: PermissionState): string {
  const { identity, control } = state;
  const sentences = {
    nobody: t("control.nobody"),
    mine: t("control.mine"),
    another: control.free_in_s === null ? t("control.another", { name: control.holder }) : t("control.another_until", { name: control.holder, seconds: control.free_in_s }),
  };
  const sentence = control.policy === "shared" ? "" : sentences[controlHolder(state)];
  if (identity?.role !== "view" && identity?.role !== "propose") return sentence;
  return `${t("control.read_only", { role: identity.role })} ${sentence}`.trim();
}
