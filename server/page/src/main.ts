import "./style.css";
import { exposeToConsole } from "./inspect";
import { Authentication, storedToken, takeTokenFromUrl } from "./link/authentication";
import { ArmCommands, StopCommand } from "./link/commands";
import { Connection, serverUrl } from "./link/connection";
import { moveObject } from "./link/messages";
import { MoveGroupClient, subscribeDisplayedPlans } from "./link/move-group";
import { checkReachability } from "./link/reachability";
import { fetchActions, resetAfterReconnect, subscribeControl, subscribeControllerState, subscribeTopics } from "./link/subscriptions";
import { createPanel } from "./panel/panel";
import { emptyState } from "./state/state";
import { Store } from "./state/store";
import type { ObjectMoved } from "./view/interactive-markers";
import { startView } from "./view/view";

/** Start the page: the panel first, so that STOP is there even if the rest fails. */
function startPage(): void {
  const url = serverUrl(location.href);
  const store = new Store(emptyState(url));
  takeTokenFromUrl();
  const connection = new Connection(url, (status) => store.patch("link", status), storedToken);
  const authentication = new Authentication(connection, store);
  const moveGroup = new MoveGroupClient(connection, store);
  const commands = new ArmCommands(connection, store);
  const stopCommand = new StopCommand(connection, store, () => moveGroup.cancel());
  createPanel({ store, moveGroup, commands, stopCommand, authentication });
  subscribeTopics(connection, store);
  subscribeControl(connection, store);
  checkReachability(connection, store);
  subscribeDisplayedPlans(connection, store, moveGroup);
  const subscribed_topics = new Set<string>();
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      if (!connected) return;
      resetAfterReconnect(store);
      subscribeControllerState(connection, store, subscribed_topics).catch(() => undefined);
      fetchActions(connection, store).catch(() => undefined);
    },
  );
  connection.open();
  const canvas = document.querySelector<HTMLCanvasElement>("#view");
  const moved: ObjectMoved = (...pose) => commands.publishCollisionObject(moveObject(...pose));
  exposeToConsole(store, canvas && startView(canvas, store, moved));
}

startPage();
