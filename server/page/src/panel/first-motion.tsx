import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { firstPose } from "../logic/first-motion";
import { groupPoses } from "../logic/joints";
import { loadPreference, storePreference } from "../state/preferences";
import { selectGoal } from "../state/store";
import { t } from "../texts/texts";
import { Button, Gate, SignButton, usePage, useSlowState } from "./ui";

const SEEN = "first-motion-seen";

/** Offer of a first motion, which goes for good once the arm has moved or it is put away. */
export function FirstMotion(): JSX.Element | null {
  const [seen, see] = useState(() => loadPreference(SEEN, "") === "true");
  const forget = (): void => {
    see(true);
    storePreference(SEEN, "true");
  };
  return seen ? null : <Offer forget={forget} />;
}

function Offer({ forget }: { forget: () => void }): JSX.Element {
  const { store, moveGroup } = usePage();
  const state = useSlowState();
  const is_moving = state.arm.mode === "moving";
  useEffect(() => void (is_moving && forget()), [is_moving]);
  const resting = state.link.connected && state.arm.mode === "holding" && state.plan.trajectory === null && state.selection.kind === "none";
  const pose = resting ? firstPose(state) : null;
  const go = (): void => {
    if (pose === null) return;
    selectGoal(store, "named", groupPoses(store.state)[pose]?.joints ?? null, pose);
    void moveGroup.planAndExecute();
  };
  return (
    <aside class="first-motion" data-testid="first-motion" aria-label={t("first.title")} hidden={pose === null}>
      <p>{t("first.sentence")}</p>
      <Gate to="drive"><Button class="primary" testid="first-motion-go" press={go}>{t("first.go", { pose: pose ?? "" })}</Button></Gate>
      <SignButton sign="×" testid="first-motion-away" label={t("bar.dismiss")} press={forget} />
    </aside>
  );
}
