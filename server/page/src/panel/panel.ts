import { controlBar, tokenForm } from "./access";
import { watchPermissions, type PanelContext } from "./context";
import { logSection, servosSection } from "./diagnostics";
import { button, el, loadPreference, setText, storePreference } from "./dom";
import { gripperSection, groupChoice, jointsSection, targetSection } from "./goal-inputs";
import { jogSection } from "./jog";
import { activeGoalsSection, motionSection, planScrubber } from "./motion";
import { plotsSection } from "./plots";
import { sceneSection } from "./scene";
import { noticeList, statusHeader } from "./status";

type Section = (context: PanelContext) => HTMLElement;

const SECTIONS: Section[] = [
  groupChoice,
  motionSection,
  targetSection,
  jointsSection,
  gripperSection,
  servosSection,
  sceneSection,
  activeGoalsSection,
  jogSection,
  plotsSection,
  logSection,
  themeSwitch,
];

/** Add the panel to the page: STOP first, and outside of everything that can hide it. */
export function createPanel(context: PanelContext): void {
  document.body.append(stopButton(context));
  const host = document.querySelector("#panel") ?? document.body.appendChild(el("div", { id: "panel" }));
  host.append(statusHeader(context), tokenForm(context), controlBar(context), noticeList(context));
  document.querySelector("#scene")?.append(planScrubber(context));
  for (const section of SECTIONS) host.append(section(context));
  watchPermissions(context);
}

/** Create the button that stops the arm, above everything else; Esc presses it. */
function stopButton({ store, stopCommand }: PanelContext): HTMLElement {
  const press = (): void => void stopCommand.stop();
  const stop = button("", "stop", press, "Stop the arm (Esc)");
  stop.id = "stop";
  stop.setAttribute("aria-keyshortcuts", "Escape");
  const answer = el("span", { class: "stop-answer", role: "status" });
  stop.append(el("strong", { text: "STOP" }), answer);
  const onKey = (event: KeyboardEvent): void => {
    if (event.key === "Escape" && !event.repeat) press();
  };
  // In the capturing phase, so that no other element can consume the key.
  window.addEventListener("keydown", onKey, { capture: true });
  store.subscribe(
    (state) => state.stop,
    ({ phase, text }) => {
      stop.dataset["phase"] = phase;
      setText(answer, text);
    },
  );
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      stop.dataset["link"] = connected ? "up" : "down";
      stop.title = connected ? "Stop the arm (Esc)" : "Not connected: the arm's power switch stops it";
    },
  );
  return stop;
}

/** Create the choice of colours: light, dark, or the system's; the view reads the same attribute. */
function themeSwitch(): HTMLElement {
  const options = ["system", "light", "dark"].map((value) => el("option", { text: value, attributes: { value } }));
  const choice = el("select", { testid: "theme", label: "colours" }, ...options);
  const apply = (theme: string): void => {
    if (theme === "system") delete document.documentElement.dataset["theme"];
    else document.documentElement.dataset["theme"] = theme;
  };
  choice.value = loadPreference("theme", "system");
  apply(choice.value);
  choice.addEventListener("change", () => {
    storePreference("theme", choice.value);
    apply(choice.value);
  });
  return el("label", { class: "line" }, "Colours ", choice);
}
