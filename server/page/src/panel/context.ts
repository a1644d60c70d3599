import type { Authentication } from "../link/authentication";
import type { ArmCommands, StopCommand } from "../link/commands";
import type { MoveGroupClient } from "../link/move-group";
import { denialReason, type Operation } from "../logic/permissions";
import type { State } from "../state/state";
import type { PageStore } from "../state/store";
import { el } from "./dom";

/** Services that every section of the panel uses. */
export interface PanelContext {
  store: PageStore;
  moveGroup: MoveGroupClient;
  commands: ArmCommands;
  stopCommand: StopCommand;
  authentication: Authentication;
}

/** Wrap controls in a fieldset that is disabled while the server would deny their operation. */
export function permissionFieldset(
  { store }: PanelContext,
  operation: Operation,
  ...controls: HTMLElement[]
): HTMLFieldSetElement {
  const fieldset = el("fieldset", { class: "gate", attributes: { "data-deed": operation } }, ...controls);
  applyPermission(fieldset, store.state);
  return fieldset;
}

/** Update the fieldsets of the whole page whenever permissions change. */
export function watchPermissions({ store }: PanelContext): void {
  // Found in the document each time, as rows of lists come and go with their fieldsets.
  const applyAll = (state: State): void => {
    const fieldsets = document.querySelectorAll<HTMLFieldSetElement>("fieldset.gate");
    for (const fieldset of fieldsets) applyPermission(fieldset, state);
  };
  for (const part of ["identity", "control"] as const) {
    store.subscribe((state) => state[part], (_, state) => applyAll(state));
  }
}

function applyPermission(fieldset: HTMLFieldSetElement, state: State): void {
  const reason = denialReason(fieldset.dataset["deed"] as Operation, state);
  fieldset.disabled = reason !== "";
  fieldset.title = reason;
}
