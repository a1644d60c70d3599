import type { State } from "../state/state";
import { chosenLanguage, t, useLanguage } from "../texts/texts";
import { controlBar, tokenForm } from "./access";
import { camerasSection } from "./cameras";
import { commissioningSection, procedureBar } from "./commissioning";
import { watchPermissions, type PanelContext } from "./context";
import { createDock, type Panel } from "./dock";
import { el, loadPreference, setText } from "./dom";
import { driveSection } from "./drive";
import { gripperSection, groupChoice, jointsSection, targetSection } from "./goal-inputs";
import { firstMotion } from "./first-motion";
import { activeGoalsSection, goalsSection } from "./goals";
import { healthSection } from "./health";
import { logSection } from "./log";
import { motionSection } from "./motion";
import { plotsSection } from "./plots";
import { objectsSection, sceneBar } from "./scene";
import { addObjectSection } from "./scene-add";
import { regionSection } from "./scene-region";
import { savedScenesSection } from "./scene-saved";
import { savedSequencesSection, sequenceSection } from "./sequence";
import { servosSection } from "./servos";
import { settingsSection } from "./settings";
import { shareSection } from "./share";
import { teachingSection } from "./teaching";
import { createTour } from "./tour";
import { connectionPill, noticeList, statusBar } from "./status";
import { transportBar } from "./transport";

/** Return every panel with its sections, in the order in which they are offered. */
function allPanels(context: PanelContext, tour_start: HTMLElement): Panel[] {
  const panel = (id: PanelId, place: Panel["place"], icon: string, ...sections: ((context: PanelContext) => HTMLElement)[]): Panel => {
    return { id, title: t(`panel.${id}`), place, icon, sections: sections.map((section) => section(context)) };
  };
  return [
    panel("move", "rail", "M12 2v5M12 17v5M2 12h5M17 12h5M12 8a4 4 0 1 0 0 8 4 4 0 1 0 0-8", groupChoice, motionSection, targetSection, jointsSection, gripperSection),
    panel("drive", "rail", "M7 7h10a5 5 0 0 1 0 10c-2 0-2.5-2-5-2s-3 2-5 2A5 5 0 0 1 7 7zM8 10v4M6 12h4M15 12h.01M18 10h.01", driveSection),
    panel("sequence", "rail", "M4 6h16M4 12h8M4 18h8M16 11l5 4-5 4z", sequenceSection, savedSequencesSection, teachingSection),
    panel("world", "rail", "M12 2l9 5v10l-9 5-9-5V7zM3 7l9 5 9-5M12 12v10", sceneBar, addObjectSection, objectsSection, savedScenesSection, regionSection),
    panel("plots", "more", "M3 3v18h18M7 15l4-5 3 3 5-7", plotsSection),
    panel("goals", "more", "M5 21V4h13l-3 4 3 4H5", activeGoalsSection, goalsSection),
    panel("arm", "more", "M4 21h9M8 21v-5L5 10l7-5 5 3M17 8l4-2M17 8l3 4", servosSection, healthSection, commissioningSection),
    panel("cameras", "more", "M3 7h4l2-3h6l2 3h4v13H3zM12 9a4 4 0 1 0 0 8 4 4 0 1 0 0-8", camerasSection),
    panel("log", "more", "M5 4h14v16H5zM8 8h8M8 12h8M8 16h5", logSection),
    panel("settings", "more", "M4 7h10M18 7h2M16 4v6M4 17h2M10 17h10M8 14v6", () => tour_start, settingsSection, shareSection),
  ];
}

type PanelId = "move" | "drive" | "sequence" | "world" | "plots" | "goals" | "arm" | "cameras" | "log" | "settings";

/** Add bar, rail and panels to the page: STOP first, and outside of everything that can hide it. */
export function createPanel(context: PanelContext): void {
  const language = chosenLanguage(loadPreference("language", ""), navigator.languages);
  document.documentElement.lang = language;
  useLanguage(language);
  const [bar, scene, rail, dock] = ["bar", "scene", "rail", "dock"].map((id) => document.getElementById(id) as HTMLElement) as [HTMLElement, HTMLElement, HTMLElement, HTMLElement];
  scene.querySelector("canvas")?.setAttribute("aria-label", t("picture.label"));
  document.body.append(stopButton(context));
  bar.append(...statusBar(context), controlBar(context), connectionPill(context));
  const tour = createTour(context);
  const above = el("div", { class: "above" }, procedureBar(context), tokenForm(context), noticeList(context));
  scene.append(above, el("div", { class: "below" }, tour.card, firstMotion(context), transportBar(context)));
  createDock(rail, dock, allPanels(context, tour.start), context.store);
  watchPermissions(context);
}

/** Create the button that stops the arm, above everything else; Esc presses it. */
function stopButton({ store, stopCommand }: PanelContext): HTMLElement {
  const press = (): void => void stopCommand.stop();
  const stop = el("button", { type: "button", testid: "stop", title: t("stop.title") });
  // A second finger makes no click, and a click comes when the finger is lifted.
  stop.addEventListener("pointerdown", press);
  // That of a key or a screen reader has no pointer.
  stop.addEventListener("click", ({ detail }) => detail === 0 && press());
  stop.id = "stop";
  stop.setAttribute("aria-keyshortcuts", "Escape");
  const answer = el("span", { class: "stop-answer", role: "status" });
  stop.append(el("strong", { text: t("stop.word") }), answer);
  const onKey = (event: KeyboardEvent): void => {
    if (event.key === "Escape" && !event.repeat) press();
  };
  // In the capturing phase, so that no other element can consume the key.
  window.addEventListener("keydown", onKey, { capture: true });
  const show = ({ stop: { phase, text }, link: { connected } }: State): void => {
    stop.dataset["phase"] = phase;
    stop.dataset["link"] = connected ? "up" : "down";
    stop.title = t(connected ? "stop.title" : "stop.offline");
    setText(answer, text || (connected ? "" : t("stop.offline")));
    document.body.dataset["link"] = connected ? "up" : "down";
  };
  store.subscribe((state) => state.stop, (_, state) => show(state));
  store.subscribe((state) => state.link.connected, (_, state) => show(state));
  return stop;
}
