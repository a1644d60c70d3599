import type { Authentication } from "../link/authentication";
import type { Cameras } from "../link/cameras";
import type { ArmCommands, StopCommand } from "../link/commands";
import type { CommissioningCommands } from "../link/commissioning";
import type { GoalRecord } from "../link/goal-history";
import type { MoveGroupClient } from "../link/move-group";
import type { PhoneAccess } from "../link/phone";
import type { SceneEditor } from "../link/scene-editor";
import type { SequencePlayer } from "../link/sequence";
import type { JogSender } from "../link/servo-node";
import type { Teaching } from "../link/teaching";
import type { ServoHistory } from "../logic/servo-history";
import { denialReason, type Operation } from "../logic/permissions";
import type { State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { el } from "./dom";

/** Services that every section of the panel uses. */
export interface PanelContext {
  store: PageStore;
  moveGroup: MoveGroupClient;
  commands: ArmCommands;
  stopCommand: StopCommand;
  jogSender: JogSender;
  commissioning: CommissioningCommands;
  authentication: Authentication;
  /** Asks the server for a way in for another device. */
  phoneAccess: (role: string) => Promise<PhoneAccess>;
  sceneEditor: SceneEditor;
  sequencePlayer: SequencePlayer;
  cameras: Cameras;
  teaching: Teaching;
  /** Asks the server for the last minutes of a joint's servo; null where it has none. */
  servoHistory: (joint: string) => Promise<ServoHistory | null>;
  /** Asks the server for the record of a goal; a text is its reason for having none. */
  goalRecord: (id: string) => Promise<GoalRecord | string>;
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
  store.watch(["identity", "control"], applyAll);
  store.subscribe((state) => state.link.connected, (_, state) => applyAll(state));
}

function applyPermission(fieldset: HTMLFieldSetElement, state: State): void {
  const offline = state.link.connected ? "" : t("bar.offline.disabled");
  const reason = offline || denialReason(fieldset.dataset["deed"] as Operation, state);
  fieldset.disabled = reason !== "";
  fieldset.title = reason;
}
