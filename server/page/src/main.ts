import "./style.css";
import "./accessibility.css";
import { exposeToConsole } from "./inspect";
import { Authentication, storedToken, takeTokenFromUrl } from "./link/authentication";
import { Cameras } from "./link/cameras";
import { Classroom } from "./link/classroom";
import { ArmCommands, StopCommand } from "./link/commands";
import { CommissioningCommands, subscribeCommissioning } from "./link/commissioning";
import { Connection, serverUrl } from "./link/connection";
import { MoveGroupClient, subscribeDisplayedPlans } from "./link/move-group";
import { RegionScan } from "./link/reachable-region";
import { checkReachability } from "./link/reachability";
import { fetchGoalHistory } from "./link/goal-history";
import { SceneEditor } from "./link/scene-editor";
import { SequencePlayer } from "./link/sequence";
import { Teaching } from "./link/teaching";
import { JogSteps } from "./link/jog-steps";
import { JogSender, subscribeServoNode } from "./link/servo-node";
import { subscribeSpeedLimit } from "./link/speed-limit";
import { resetAfterReconnect, subscribeControl, subscribeControllerState, subscribeTopics } from "./link/subscriptions";
import { createPanel } from "./panel/panel";
import { loadPreference } from "./state/preferences";
import { emptyState } from "./state/state";
import { Store } from "./state/store";
import { chosenLanguage, useLanguage } from "./texts/texts";
import { startView } from "./view/view";

/** Time for the texts of the language [ms], a file of 30 kB beside this one. */
const LANGUAGE_TIMEOUT_MS = 2000;

/** Start the page: the panel first, so that STOP is there even if the rest fails. */
async function startPage(): Promise<void> {
  const language = chosenLanguage(loadPreference("language", ""), navigator.languages);
  document.documentElement.lang = language;
  // English where the texts of another language do not come: STOP must not wait for them.
  const patience = new Promise((resolve) => setTimeout(resolve, LANGUAGE_TIMEOUT_MS));
  await Promise.race([useLanguage(language).catch(() => undefined), patience]);
  const url = serverUrl(location.href);
  const store = new Store(emptyState(url));
  takeTokenFromUrl();
  const connection = new Connection(url, (status) => store.patch("link", status), storedToken);
  const authentication = new Authentication(connection, store);
  const moveGroup = new MoveGroupClient(connection, store);
  const commands = new ArmCommands(connection, store);
  const jogSender = new JogSender(connection, store, commands);
  const jogSteps = new JogSteps(connection, store, moveGroup, commands, jogSender);
  const stopCommand = new StopCommand(connection, store, () => {
    jogSender.releaseAll();
    moveGroup.cancel();
  });
  const commissioning = new CommissioningCommands(connection, store);
  const sceneEditor = new SceneEditor(connection, store);
  const sequencePlayer = new SequencePlayer(connection, store);
  const teaching = new Teaching(connection, store);
  createPanel({ connection, store, moveGroup, commands, stopCommand, jogSender, jogSteps, commissioning, authentication, sceneEditor, sequencePlayer, teaching, cameras: new Cameras(connection), classroom: new Classroom(connection, store) });
  subscribeTopics(connection, store);
  subscribeControl(connection, store);
  subscribeCommissioning(connection, store);
  subscribeServoNode(connection, store);
  subscribeSpeedLimit(connection, store);
  checkReachability(connection, store);
  new RegionScan(connection, store);
  subscribeDisplayedPlans(connection, store, moveGroup);
  const subscribed_topics = new Set<string>();
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      if (!connected) return;
      resetAfterReconnect(store);
      subscribeControllerState(connection, store, subscribed_topics).catch(() => undefined);
      fetchGoalHistory(connection, store).catch(() => undefined);
    },
  );
  connection.open();
  const canvas = document.querySelector<HTMLCanvasElement>("#view");
  exposeToConsole(store, canvas && startView(canvas, store, (...pose) => void sceneEditor.move(...pose)));
}

void startPage();
