import { emptyState } from "../state/state";
import { Store } from "../state/store";
import { Authentication, storedToken } from "./authentication";
import { Cameras } from "./cameras";
import { Classroom } from "./classroom";
import { ArmCommands, StopCommand } from "./commands";
import { CommissioningCommands } from "./commissioning";
import { Connection } from "./connection";
import { JogSteps } from "./jog-steps";
import { MoveGroupClient } from "./move-group";
import { SceneEditor } from "./scene-editor";
import { SequencePlayer } from "./sequence";
import { JogSender } from "./servo-node";
import { Teaching } from "./teaching";

/** Services of the page, which its panels use; the connection is opened later. */
export type Services = ReturnType<typeof createServices>;

export function createServices(url: string) {
  const store = new Store(emptyState(url));
  const connection = new Connection(url, (status) => store.patch("link", status), storedToken);
  const moveGroup = new MoveGroupClient(connection, store);
  const commands = new ArmCommands(connection, store);
  const jogSender = new JogSender(connection, store, commands);
  const stopCommand = new StopCommand(connection, store, () => {
    jogSender.releaseAll();
    moveGroup.cancel();
  });
  return {
    store,
    connection,
    moveGroup,
    commands,
    jogSender,
    stopCommand,
    jogSteps: new JogSteps(connection, store, moveGroup, commands, jogSender),
    authentication: new Authentication(connection, store),
    commissioning: new CommissioningCommands(connection, store),
    sceneEditor: new SceneEditor(connection, store),
    sequencePlayer: new SequencePlayer(connection, store),
    teaching: new Teaching(connection, store),
    cameras: new Cameras(connection),
    classroom: new Classroom(connection, store),
  };
}
