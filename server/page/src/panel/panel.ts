import type { State } from "../state/state";
import { chosenLanguage, t, useLanguage } from "../texts/texts";
import { controlBar, tokenForm } from "./access";
import { commissioningSection, procedureBar } from "./commissioning";
import { watchPermissions, type PanelContext } from "./context";
import { Dock, type Panel } from "./dock";
import { el, loadPreference, setText } from "./dom";
import { driveSection } from "./drive";
import { gripperSection, groupChoice, jointsSection, targetSection } from "./goal-inputs";
import { firstMotion } from "./first-motion";
import { activeGoalsSection, goalsSection } from "./goals";
import { healthSection } from "./health";
import { logSection } from "./log";
import { motionBar } from "./motion-bar";
import { motionSection, planScrubber } from "./motion";
import { phoneSection } from "./phone";
import { plotsSection } from "./plots";
import { objectsSection, sceneBar } from "./scene";
import { addObjectSection } from "./scene-add";
import { regionSection } from "./scene-region";
import { savedScenesSection } from "./scene-saved";
import { savedSequencesSection, sequenceSection } from "./sequence";
import { servosSection } from "./servos";
import { settingsSection } from "./settings";
import { teachingSection } from "./teaching";
import { connectionPill, noticeList, statusBar } from "./status";

/** Return every panel with its sections, in the order in which they are offered. */
function allPanels(context: PanelContext): Panel[] {
  const create = (...sections: ((context: PanelContext) => HTMLElement)[]): HTMLElement[] => {
    return sections.map((section) => section(context));
  };
  return [
    { id: "move", title: t("panel.move"), sections: create(groupChoice, motionSection, targetSection, jointsSection, gripperSection) },
    { id: "drive", title: t("panel.drive"), sections: create(driveSection, phoneSection) },
    { id: "sequence", title: t("panel.sequence"), sections: create(sequenceSection, savedSequencesSection, teachingSection) },
    { id: "world", title: t("panel.world"), sections: create(sceneBar, addObjectSection, objectsSection, savedScenesSection, regionSection) },
    { id: "plots", title: t("panel.plots"), sections: create(plotsSection) },
    { id: "goals", title: t("panel.goals"), sections: create(activeGoalsSection, goalsSection) },
    { id: "arm", title: t("panel.arm"), sections: create(servosSection, healthSection, commissioningSection) },
    { id: "log", title: t("panel.log"), sections: create(logSection) },
    { id: "settings", title: t("panel.settings"), sections: create(settingsSection) },
  ];
}

/** Add bar and panels to the page: STOP first, and outside of everything that can hide it. */
export function createPanel(context: PanelContext): void {
  const language = chosenLanguage(loadPreference("language", ""), navigator.languages);
  document.documentElement.lang = language;
  useLanguage(language);
  document.querySelector("#view")?.setAttribute("aria-label", t("picture.label"));
  document.body.append(stopButton(context));
  const bar = document.querySelector("#bar") ?? document.body.appendChild(el("header", { id: "bar" }));
  bar.append(...statusBar(context), motionBar(context), controlBar(context), connectionPill(context));
  bar.append(procedureBar(context), tokenForm(context), noticeList(context));
  document.querySelector("#scene")?.append(firstMotion(context), planScrubber(context));
  const host = document.querySelector<HTMLElement>("#dock") ?? document.body.appendChild(el("aside", { id: "dock" }));
  new Dock(host, allPanels(context), context.store);
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
  };
  store.subscribe((state) => state.stop, (_, state) => show(state));
  store.subscribe((state) => state.link.connected, (_, state) => show(state));
  return stop;
}
