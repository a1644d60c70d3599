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
import type { PageStore } from "../state/store";

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
