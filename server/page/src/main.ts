import "./style.css";
import "./accessibility.css";
import { exposeToConsole } from "./inspect";
import { takeTokenFromUrl } from "./link/authentication";
import { subscribeCommissioning } from "./link/commissioning";
import { serverUrl } from "./link/connection";
import { fetchGoalHistory } from "./link/goal-history";
import { subscribeDisplayedPlans } from "./link/move-group";
import { RegionScan } from "./link/reachable-region";
import { checkReachability } from "./link/reachability";
import { createServices } from "./link/services";
import { subscribeServoNode } from "./link/servo-node";
import { followCommands, resetAfterReconnect, subscribeControl, subscribeTopics } from "./link/subscriptions";
import { createPanel } from "./panel/panel";
import { loadPreference } from "./state/preferences";
import { onConnect } from "./state/store";
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
  takeTokenFromUrl();
  const services = createServices(serverUrl(location.href));
  const { connection, store, moveGroup, sceneEditor } = services;
  connection.open();
  createPanel(services);
  subscribeTopics(connection, store);
  followCommands(connection, store);
  subscribeControl(connection, store);
  subscribeCommissioning(connection, store);
  subscribeServoNode(connection, store);
  checkReachability(connection, store);
  new RegionScan(connection, store);
  subscribeDisplayedPlans(connection, store, moveGroup);
  onConnect(store, () => {
    resetAfterReconnect(store);
    fetchGoalHistory(connection, store).catch(() => undefined);
  });
  const canvas = document.querySelector<HTMLCanvasElement>("#view");
  exposeToConsole(store, canvas && startView(canvas, store, (...pose) => void sceneEditor.move(...pose)));
}

void startPage();
