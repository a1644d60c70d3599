import { effect } from "@preact/signals";
import { render, type JSX } from "preact";
import { INITIAL_LAYOUT, parseLayout, PICTURE_ALONE } from "../logic/layout";
import type { Services } from "../link/services";
import { loadPreference, storePreference } from "../state/preferences";
import { t } from "../texts/texts";
import { ControlBar, TokenForm } from "./access";
import { CamerasPanel } from "./cameras";
import { ClassroomPanel } from "./classroom";
import { CommissioningSection, ProcedureBar } from "./commissioning";
import { Card, changeLayout, Rail, SMALL_SCREEN, type Panel } from "./dock";
import { Drive } from "./drive";
import { FirstMotion } from "./first-motion";
import { Gripper, GroupChoice, JointValuesSection, Target } from "./goal-inputs";
import { ActiveGoals, GoalHistory } from "./goals";
import { Health } from "./health";
import { LogPanel } from "./log";
import { Motion } from "./motion";
import { Plots } from "./plots";
import { EpisodesSection, LeaderSection, PolicySection } from "./recording";
import { ObjectsSection, SceneBar } from "./scene";
import { AddObject } from "./scene-add";
import { RegionSection } from "./scene-region";
import { Scenarios } from "./scenarios";
import { SavedScenes } from "./scene-saved";
import { SequenceSection } from "./sequence";
import { keepSequences, SavedSequences } from "./sequence-saved";
import { ServosSection } from "./servos";
import { loadSettings, Settings } from "./settings";
import { Share } from "./share";
import { ConnectionPill, Notices, StatusBar } from "./status";
import { TeachingSection } from "./teaching";
import { Tour, TourStart } from "./tour";
import { TransportBar } from "./transport";
import { Page, usePage } from "./ui";

const PANELS: readonly Panel[] = [
  { id: "move", place: "rail", icon: "M12 2v5M12 17v5M2 12h5M17 12h5M12 8a4 4 0 1 0 0 8 4 4 0 1 0 0-8", sections: [GroupChoice, Motion, Target, JointValuesSection, Gripper] },
  { id: "drive", place: "rail", icon: "M7 7h10a5 5 0 0 1 0 10c-2 0-2.5-2-5-2s-3 2-5 2A5 5 0 0 1 7 7zM8 10v4M6 12h4M15 12h.01M18 10h.01", sections: [Drive] },
  { id: "sequence", place: "rail", icon: "M4 6h16M4 12h8M4 18h8M16 11l5 4-5 4z", sections: [SequenceSection, SavedSequences, TeachingSection] },
  { id: "world", place: "rail", icon: "M12 2l9 5v10l-9 5-9-5V7zM3 7l9 5 9-5M12 12v10", sections: [SceneBar, Scenarios, AddObject, ObjectsSection, SavedScenes, RegionSection] },
  { id: "plots", place: "more", icon: "M3 3v18h18M7 15l4-5 3 3 5-7", sections: [Plots] },
  { id: "goals", place: "more", icon: "M5 21V4h13l-3 4 3 4H5", sections: [ActiveGoals, GoalHistory] },
  { id: "arm", place: "more", icon: "M4 21h9M8 21v-5L5 10l7-5 5 3M17 8l4-2M17 8l3 4", sections: [ServosSection, Health, CommissioningSection] },
  { id: "cameras", place: "more", icon: "M3 7h4l2-3h6l2 3h4v13H3zM12 9a4 4 0 1 0 0 8 4 4 0 1 0 0-8", sections: [CamerasPanel] },
  { id: "recording", place: "more", icon: "M12 4a8 8 0 1 0 0 16 8 8 0 1 0 0-16M12 9a3 3 0 1 0 0 6 3 3 0 1 0 0-6", sections: [EpisodesSection, LeaderSection, PolicySection] },
  { id: "class", place: "more", icon: "M3 4h7v7H3zM14 4h7v7h-7zM3 14h7v6H3zM14 14h7v6h-7z", sections: [ClassroomPanel] },
  { id: "log", place: "more", icon: "M5 4h14v16H5zM8 8h8M8 12h8M8 16h5", sections: [LogPanel] },
  { id: "settings", place: "more", icon: "M4 7h10M18 7h2M16 4v6M4 17h2M10 17h10M8 14v6", sections: [TourStart, Settings, Share] },
];

/** Add bar, rail and panels to the page: STOP first, and outside of everything that can hide it. */
export function createPanel(context: Services): void {
  const { store } = context;
  const show = (id: string, content: JSX.Element): HTMLElement => {
    const place = document.getElementById(id) as HTMLElement;
    render(<Page.Provider value={context}>{content}</Page.Provider>, place);
    return place;
  };
  show("stop-place", <Stop />);
  window.addEventListener(
    "keydown",
    (event) => {
      if (event.key === "Escape" && !event.repeat) void context.stopCommand.stop();
    },
    // In the capturing phase, so that no other element can consume the key.
    { capture: true },
  );
  document.querySelector("#view")?.setAttribute("aria-label", t("picture.label"));
  loadSettings(store);
  keepSequences(store);
  show("bar", <><h1 class="unseen">{"armbridge"}</h1><StatusBar /><ControlBar /><ConnectionPill /></>);
  show("above", <><ProcedureBar /><TokenForm /><Notices /></>);
  show("below", <><Tour /><FirstMotion /><TransportBar /></>);
  changeLayout(store, parseLayout(loadPreference("shown-panels", ""), PANELS.map(({ id }) => id), SMALL_SCREEN.matches ? PICTURE_ALONE : INITIAL_LAYOUT));
  const rail = show("rail", <Rail panels={PANELS} />);
  const dock = show("dock", <Cards />);
  for (const place of [rail, dock]) place.setAttribute("aria-label", t("layout.panels"));
  effect(() => {
    const { layout, link: { connected } } = store.state;
    storePreference("shown-panels", JSON.stringify(layout));
    dock.hidden = layout.shown === "" && layout.pinned === "";
    document.body.dataset.link = connected ? "up" : "down";
  });
}

function Cards(): JSX.Element[] {
  return PANELS.map((panel) => <Card key={panel.id} panel={panel} />);
}

function Stop(): JSX.Element {
  const { store, stopCommand } = usePage();
  const { stop: { phase, text }, link: { connected } } = store.state;
  const press = (): void => void stopCommand.stop();
  return (
    <button
      type="button" id="stop" data-testid="stop" aria-keyshortcuts="Escape"
      data-phase={phase} data-link={connected ? "up" : "down"} title={t(connected ? "stop.title" : "stop.offline")}
      // A second finger makes no click, and a click comes when the finger is lifted.
      onPointerDown={press}
      // The click of a key or a screen reader has no pointer.
      onClick={({ detail }) => detail === 0 && press()}
    >
      <strong>{t("stop.word")}</strong>
      <span class="stop-answer" role="status">{text || (connected ? "" : t("stop.offline"))}</span>
    </button>
  );
}
