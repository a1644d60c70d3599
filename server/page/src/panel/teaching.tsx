import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { t } from "../texts/texts";
import { Button, DeleteButton, Gate, Line, NameForm, NumberField, Problems, Section, Tick, usePage } from "./ui";

/** Fastest replay, as a multiple of the speed in which the motion was shown; as the server's. */
const MAX_SPEED = 2;

export function TeachingSection(): JSX.Element {
  const { store: { state }, teaching } = usePage();
  const { motions, recording, replaying, told } = state.teaching;
  const [speed, setSpeed] = useState(1);
  const [reverse, setReverse] = useState(false);
  const has_motions = motions !== null && motions.length > 0;
  const range = { name: t("teaching.speed"), lower: 1, upper: MAX_SPEED * 100, unit: " %", digits: 0 };
  return (
    <Section name="teaching" title={t("teaching.title")} open={false} hidden={motions === null && recording === null}>
      <RecordForm />
      <div hidden={!has_motions}>
        <Problems>
          <Line text={`${t("teaching.speed")} (%)`}><NumberField testid="replay-speed" label={t("teaching.speed")} range={range} text={String(Math.round(speed * 100))} take={(percent) => setSpeed(percent / 100)} /></Line>
        </Problems>
        <Tick testid="replay-reverse" checked={reverse} take={setReverse} text={` ${t("teaching.reverse")}`} />
      </div>
      <p class="hint" hidden={has_motions}>{t("teaching.empty")}</p>
      <ul class="things" data-testid="taught-motions">
        {(motions ?? []).map((name) => <Motion key={name} name={name} replay={() => void teaching.replay(name, speed, reverse)} />)}
      </ul>
      <Button testid="stop-replay" hidden={replaying === null} press={() => teaching.stop()}>{t("teaching.stop")}</Button>
      <p role="status" data-testid="teach-told">{told}</p>
    </Section>
  );
}

function RecordForm(): JSX.Element {
  const { store: { state }, teaching } = usePage();
  const { recording } = state.teaching;
  return (
    <Gate to="work">
      <div hidden={recording !== null}>
        <NameForm testid="teach-name" label={t("teaching.name")} button={t("teaching.record")} button_testid="teach-begin" title={t("teaching.record.title")} submit={(name) => teaching.work("begin", { name, group: "" })} />
      </div>
      <div hidden={recording === null}>
        <p data-testid="teach-recording">{recording && t("teaching.recording", { name: recording.name, seconds: recording.duration_s.toFixed(1) })}</p>
        <div class="buttons">
          <Button testid="teach-end" press={() => void teaching.work("end")}>{t("teaching.end")}</Button>
          <Button testid="teach-discard" press={() => void teaching.work("discard")}>{t("teaching.discard")}</Button>
        </div>
      </div>
    </Gate>
  );
}

function Motion({ name, replay }: { name: string; replay: () => void }): JSX.Element {
  const { store: { state }, teaching } = usePage();
  const { edited, replaying } = state.teaching;
  const is_open = edited?.name === name;
  const label = (text: string): string => `${text}: ${name}`;
  return (
    <li>
      <b>{name}</b>
      <Gate to="drive" moves><Button testid={`replay-${name}`} disabled={replaying !== null} aria-label={label(t("teaching.replay"))} press={replay}>{t("teaching.replay")}</Button></Gate>
      <Button testid={`add-motion-${name}`} title={t("teaching.add.title")} aria-label={label(t("teaching.add"))} press={() => void teaching.addToSequence(name)}>{t("teaching.add")}</Button>
      <Button testid={`waypoints-of-${name}`} title={t("teaching.as_waypoints.title")} aria-label={label(t("teaching.as_waypoints"))} press={() => void teaching.addAsWaypoints(name)}>{t("teaching.as_waypoints")}</Button>
      <Gate to="configure"><Button testid={`edit-motion-${name}`} aria-label={label(t("teaching.edit"))} aria-pressed={is_open} press={() => void teaching.edit(is_open ? null : name)}>{t("teaching.edit")}</Button></Gate>
      {is_open && <MotionEditor key={edited.duration_s} name={name} duration_s={edited.duration_s} />}
    </li>
  );
}

function MotionEditor({ name, duration_s }: { name: string; duration_s: number }): JSX.Element {
  const { teaching } = usePage();
  const [[from_s, to_s], setRange] = useState<[number, number]>([0, duration_s]);
  const [new_name, setName] = useState(name);
  const range = (text: string) => ({ name: text, lower: 0, upper: duration_s, unit: " s", digits: 2 });
  return (
    <div class="object-editor" data-testid="motion-editor">
      <Problems>
        <Gate to="configure">
          <div class="buttons">
            <Line text={`${t("teaching.from")} (s)`}><NumberField testid="trim-from" label={t("teaching.from")} range={range(t("teaching.from"))} text={String(from_s)} take={(value) => setRange([value, to_s])} /></Line>
            <Line text={`${t("teaching.to")} (s)`}><NumberField testid="trim-to" label={t("teaching.to")} range={range(t("teaching.to"))} text={to_s.toFixed(2)} take={(value) => setRange([from_s, value])} /></Line>
            <Button testid="trim-motion" press={() => void teaching.work("trim", { name, from_s, to_s })}>{t("teaching.trim")}</Button>
          </div>
          <div class="buttons">
            <Line text={t("teaching.new_name")}><input type="text" data-testid="new-motion-name" autocomplete="off" maxlength={50} value={new_name} onInput={({ currentTarget }) => setName(currentTarget.value)} /></Line>
            <Button testid="rename-motion" press={() => void teaching.work("rename", { name, new_name: new_name.trim() })}>{t("teaching.rename")}</Button>
            <DeleteButton text={t("teaching.delete")} testid="delete-motion" name={name} remove={() => void teaching.work("delete", { name })} />
          </div>
        </Gate>
      </Problems>
    </div>
  );
}
