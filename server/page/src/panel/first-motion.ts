import { firstPose } from "../logic/first-motion";
import { groupPoses } from "../logic/joints";
import type { State } from "../state/state";
import { selectGoal } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, loadPreference, setText, storePreference } from "./dom";

/** Preference that the arm has been moved from this browser, or the offer put away. */
const SEEN = "first-motion-seen";

/** Create the offer of a first motion, which goes for good once the arm has moved or it is put away. */
export function firstMotion(context: PanelContext): HTMLElement {
  const { store, moveGroup } = context;
  let seen = loadPreference(SEEN, "") === "true";
  let pose: string | null = null;
  const sentence = el("p");
  const go = button("", "first-motion-go", () => {
    if (pose === null) return;
    selectGoal(store, "named", groupPoses(store.state)[pose]?.joints ?? null, pose);
    void moveGroup.planAndExecute();
  });
  go.classList.add("primary");
  const forget = (): void => {
    seen = true;
    storePreference(SEEN, "true");
    box.hidden = true;
  };
  const away = button("×", "first-motion-away", forget, t("bar.dismiss"));
  away.setAttribute("aria-label", t("bar.dismiss"));
  const box = el("aside", { class: "first-motion", testid: "first-motion", label: t("first.title") });
  box.append(sentence, permissionFieldset(context, "drive", go), away);
  setText(sentence, t("first.sentence"));
  const show = (state: State): void => {
    if (seen) return;
    if (state.arm.mode === "moving") return forget();
    const resting = state.link.connected && state.arm.mode === "holding" && state.plan.trajectory === null && state.selection.kind === "none";
    const found = resting ? firstPose(state) : null;
    box.hidden = found === null;
    if (found === null || found === pose) return;
    pose = found;
    setText(go, t("first.go", { pose }));
  };
  box.hidden = true;
  store.watch(["link", "arm", "joints", "named", "limits", "plan", "selection"], show);
  return box;
}
