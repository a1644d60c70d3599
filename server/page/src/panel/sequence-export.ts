import { armGripper, gripperAction } from "../logic/joints";
import { sequenceProgram, type ProgramLanguage } from "../logic/sequence-program";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { button, el } from "./dom";
import { saveFile } from "./files";

/** Create the buttons that export the sequence as a program. */
export function programButtons(store: PageStore): HTMLElement {
  const save = (language: ProgramLanguage): void => {
    const { sequence, link, actions } = store.state;
    const gripper = armGripper(store.state);
    const action = gripper && gripperAction(gripper, actions);
    const { file, text } = sequenceProgram(language, sequence.waypoints, link.url, action);
    saveFile(file, "text/plain", text);
  };
  const buttons = [
    button(t("sequence.export.python"), "export-python", () => save("python")),
    button(t("sequence.export.javascript"), "export-javascript", () => save("javascript")),
  ];
  store.subscribe(
    (state) => state.sequence.waypoints.length,
    (count) => {
      for (const each of buttons) each.disabled = count === 0;
    },
  );
  return el("div", {}, el("p", { class: "hint", text: t("sequence.export") }), el("div", { class: "buttons" }, ...buttons));
}
