import type { ComponentChildren, JSX } from "preact";
import { useState } from "preact/hooks";
import { groupPoses } from "../logic/joints";
import { selectGoal } from "../state/store";
import { t } from "../texts/texts";
import { nextStep } from "./transport";
import { Button, DeleteButton, Gate, NameForm, Section, Slider, usePage } from "./ui";

export function Motion(): JSX.Element {
  const { store: { state }, moveGroup, commands } = usePage();
  const is_ready = state.link.connected && state.selection.kind !== "none";
  return (
    <Section name="goals" title={t("move.title")}>
      <NamedPoses />
      <div class="buttons">
        <Gate to="drive" moves>
          <Button testid="plan-and-move" disabled={!is_ready} title={is_ready ? t("move.both.title") : nextStep(state)} press={() => void moveGroup.planAndExecute()}>{t("move.both")}</Button>
        </Gate>
      </div>
      <div class="rows speeds">
        <PlanningSpeed />
        <Gate to="drive"><ExecutionPace /></Gate>
        <Gate to="work"><SpeedLimit /></Gate>
      </div>
      {/* The bar offers to hold again. */}
      <div class="buttons">
        <Gate to="drive">
          <Button testid="relax" title={t("move.relax.title")} disabled={["", "relaxing", "relaxed", "disconnected"].includes(state.arm.mode)} press={() => void commands.trigger("/arm/relax")}>{t("move.relax")}</Button>
        </Gate>
      </div>
    </Section>
  );
}

function NamedPoses(): JSX.Element {
  const { store, commands } = usePage();
  const poses = Object.entries(groupPoses(store.state));
  return (
    <div>
      <div class="chips" data-testid="named" role="group" aria-label={t("move.poses")}>
        {poses.length === 0 && <p class="hint">{t("move.no_poses")}</p>}
        {poses.map(([name, { saved }]) => saved
          ? <span key={name} class="chip-pair"><Pose name={name} /><Gate to="configure"><DeleteButton text="×" testid={`delete-${name}`} name={name} remove={() => void commands.deletePose(name)} /></Gate></span>
          : <Pose key={name} name={name} />)}
      </div>
      <Gate to="configure">
        <NameForm testid="save-name" label={t("move.save.label")} button={t("move.save")} button_testid="save" submit={(name) => name !== "" && commands.savePose(name)} />
      </Gate>
    </div>
  );
}

function Pose({ name }: { name: string }): JSX.Element {
  const { store } = usePage();
  const choose = (): void => selectGoal(store, "named", groupPoses(store.state)[name]?.joints ?? null, name);
  return <Button testid={`named-${name}`} title={t("move.pose.title", { name })} aria-pressed={store.state.selection.name === name} press={choose}>{name}</Button>;
}

/** Least fraction of the joints' speed limits; below it a motion takes minutes. */
const MIN_SPEED = 0.01;

interface FractionProps {
  testid: string;
  label: string;
  least: number;
  value: number;
  take: (fraction: number) => void;
  release?: (fraction: number) => void;
}

function FractionSlider({ testid, label, least, value, ...taking }: FractionProps): JSX.Element {
  const text: ComponentChildren = `${Math.round(value * 100)} %`;
  return <label class="line"><span>{label}</span><Slider testid={testid} label={label} range={[least, 1, 0.01]} value={value} {...taking} /><output data-testid={`${testid}-text`}>{text}</output></label>;
}

function PlanningSpeed(): JSX.Element {
  const { store } = usePage();
  return <FractionSlider testid="speed" label={t("move.speed")} least={MIN_SPEED} value={store.state.settings.speed} take={(speed) => store.patch("settings", { speed })} />;
}

function ExecutionPace(): JSX.Element {
  const { store, commands } = usePage();
  return <FractionSlider testid="pace" label={t("move.pace")} least={0} value={store.state.arm.speed_factor} take={(factor) => commands.publish("/arm/speed_factor", "std_msgs/Float64", { data: factor })} />;
}

function SpeedLimit(): JSX.Element {
  const { store, commands } = usePage();
  // The limit that is being chosen; null shows the server's.
  const [chosen, choose] = useState<number | null>(null);
  // At the release of the slider: each value on the way would be a line of the server's log.
  const send = async (limit: number): Promise<void> => {
    await commands.setSpeedLimit(limit);
    choose(null);
  };
  return <FractionSlider testid="speed-limit" label={t("move.limit")} least={MIN_SPEED} value={chosen ?? store.state.speed_limit} take={choose} release={(limit) => void send(limit)} />;
}
