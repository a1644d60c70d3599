import "./sequence.css";
import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { setWaypoints } from "../link/sequence";
import { armGripper, armJoints, currentPositions } from "../logic/joints";
import { inUnits, type UnitSystem } from "../logic/numbers";
import { planningGroup } from "../logic/robot-info";
import { edited, MAX_PAUSE_S, MAX_WAYPOINTS, MIN_SPEED, moved, newWaypoint, openShare, poseKey, sequenceDuration_s, type LegCheck, type Waypoint } from "../logic/sequence";
import type { JointValues, State } from "../state/state";
import { selectGoal } from "../state/store";
import { t } from "../texts/texts";
import { Button, Gate, NumberField, Problems, Section, Select, SignButton, TextField, Tick, useKeptFocus, usePage, useSlowState } from "./ui";

export function SequenceSection(): JSX.Element {
  const { waypoints, playing } = usePage().store.state.sequence;
  const list = useKeptFocus<HTMLOListElement>();
  return (
    <Section name="sequence" title={t("sequence.title")}>
      <fieldset class="editing" disabled={playing !== null}>
        <AddButtons />
        <p class="hint" hidden={waypoints.length > 0}>{t("sequence.empty")}</p>
        <ol ref={list} class="waypoints" data-testid="waypoints" aria-label={t("sequence.waypoints")}>
          {waypoints.map((waypoint, index) => <WaypointRow key={waypoint.id} waypoint={waypoint} index={index} />)}
        </ol>
      </fieldset>
      <PlayControls />
    </Section>
  );
}

function AddButtons(): JSX.Element {
  const { store } = usePage();
  const state = useSlowState();
  const full = state.sequence.waypoints.length >= MAX_WAYPOINTS;
  const add = (joints_rad: JointValues | null): void => {
    const { sequence, settings } = store.state;
    if (joints_rad === null || sequence.waypoints.length >= MAX_WAYPOINTS) return;
    const group = planningGroup(store.state)?.name ?? "";
    setWaypoints(store, [...sequence.waypoints, newWaypoint(sequence.waypoints, group, joints_rad, settings.speed)]);
  };
  return (
    <div class="buttons">
      <Button testid="add-here" title={full ? t("sequence.full", { limit: MAX_WAYPOINTS }) : ""} disabled={full || presentJoints(state) === null} press={() => add(presentJoints(store.state))}>{t("sequence.add_here")}</Button>
      <Button testid="add-goal" title={t("sequence.add_goal.title")} disabled={full || chosenJoints(state) === null} press={() => add(chosenJoints(store.state))}>{t("sequence.add_goal")}</Button>
    </div>
  );
}

/** Return the measured positions of the group's joints; null before the server has told them all. */
function presentJoints(state: State): JointValues | null {
  return ofGroup(state, currentPositions(state));
}

/** Return the joint values of the selected goal, which the ghost shows; null without one that can be reached. */
function chosenJoints(state: State): JointValues | null {
  const { selection, target } = state;
  if (selection.kind === "none" || (selection.kind === "target" && target.reachable !== true)) return null;
  const chosen = selection.kind === "target" ? target.joints_rad : selection.joints_rad;
  return chosen && ofGroup(state, { ...currentPositions(state), ...chosen });
}

function ofGroup(state: State, values: JointValues): JointValues | null {
  const names = armJoints(state);
  const pairs = names.flatMap((name) => (values[name] === undefined ? [] : [[name, values[name]] as const]));
  return names.length > 0 && pairs.length === names.length ? Object.fromEntries(pairs) : null;
}

const DRAGGED = "application/x-waypoint";

function WaypointRow({ waypoint, index }: { waypoint: Waypoint; index: number }): JSX.Element {
  const { store } = usePage();
  const { state } = store;
  const { sequence: { waypoints, playing, checks }, thumbnails } = state;
  const [over, setOver] = useState(false);
  const { id, name, motion, joints_rad } = waypoint;
  const own = `waypoint-${id}`;
  const list = (): readonly Waypoint[] => store.state.sequence.waypoints;
  const edit = (patch: Partial<Waypoint>): void => setWaypoints(store, edited(list(), id, patch));
  const reorder = (to: number): void => setWaypoints(store, moved(list(), id, to));
  const drop = (event: DragEvent): void => {
    event.preventDefault();
    setOver(false);
    const dragged = Number(event.dataTransfer?.getData(DRAGGED));
    // It takes the place of the one that it is dropped on.
    if (dragged !== id) setWaypoints(store, moved(list(), dragged, index));
  };
  const dragOver = (event: DragEvent): void => {
    if (!event.dataTransfer?.types.includes(DRAGGED)) return;
    event.preventDefault();
    setOver(true);
  };
  const drag = ({ dataTransfer, currentTarget }: DragEvent & { currentTarget: HTMLElement }): void => {
    dataTransfer?.setData(DRAGGED, String(id));
    dataTransfer?.setDragImage(currentTarget.closest("li") ?? currentTarget, 0, 0);
  };
  const answer = checks[index];
  const is_current = playing?.index === index && playing.doing !== "check";
  const thumbnail = thumbnails[poseKey(joints_rad)];
  return (
    <li
      data-testid={own} class={over ? "drop-here" : ""} data-verdict={answer?.verdict ?? "checking"} aria-current={is_current ? "step" : undefined}
      onDragOver={dragOver} onDragLeave={() => setOver(false)} onDrop={drop}
    >
      <Problems>
        <div class="waypoint-head">
          <Button class="waypoint-picture" testid={`${own}-show`} title={t("sequence.show.title")} aria-label={`${t("sequence.show")}: ${name}`} press={() => selectGoal(store, "joints", joints_rad)}>
            <img class="thumbnail" alt="" width={84} height={63} hidden={!thumbnail} src={thumbnail} />
          </Button>
          <GripperStrip own={own} index={index} />
          <TextField testid={`${own}-name`} label={t("sequence.name")} maxlength={50} value={name} take={(typed) => edit({ name: typed || String(id) })} />
          <div class="waypoint-tools">
            <span class="handle" data-testid={`${own}-handle`} title={t("sequence.drag")} draggable aria-hidden="true" onDragStart={drag}>⠿</span>
            <SignButton sign="↑" testid={`${own}-up`} title={t("sequence.up")} label={`${t("sequence.up")}: ${name}`} disabled={index === 0} press={() => reorder(index - 1)} />
            <SignButton sign="↓" testid={`${own}-down`} title={t("sequence.down")} label={`${t("sequence.down")}: ${name}`} disabled={index === waypoints.length - 1} press={() => reorder(index + 1)} />
            <SignButton sign="×" testid={`${own}-remove`} title={t("sequence.remove")} label={`${t("sequence.remove")}: ${name}`} press={() => setWaypoints(store, list().filter((each) => each.id !== id))} />
          </div>
          <p class="leg-check" data-testid={`${own}-check`}>{checkText(answer, state.settings.units)}</p>
        </div>
        <div class="waypoint-fields">
          <label class="measure">
            <span>{t("sequence.way")}</span>
            {/* A taught motion ends where it ends: it is replaced by removing its row. */}
            <Select
              testid={`${own}-way`} label={t("sequence.way")} disabled={motion !== null} value={motion ? "taught" : waypoint.straight ? "straight" : "free"}
              options={motion ? [["taught", t("sequence.way.taught", { name: motion.name })]] : [["free", t("sequence.way.free")], ["straight", t("sequence.way.straight")]]}
              take={(way) => edit({ straight: way === "straight" })}
            />
          </label>
          <label class="measure">
            <span>{`${t("sequence.speed")} (%)`}</span>
            <NumberField testid={`${own}-speed`} label={t("sequence.speed")} range={{ name: t("sequence.speed"), lower: MIN_SPEED * 100, upper: 100, unit: " %", digits: 0 }} text={String(Math.round(waypoint.speed * 100))} take={(value) => edit({ speed: value / 100 })} />
          </label>
          <GripperChoice own={own} position={waypoint.gripper} edit={edit} />
          <label class="measure">
            <span>{`${t("sequence.pause")} (s)`}</span>
            <NumberField testid={`${own}-pause`} label={t("sequence.pause")} range={{ name: t("sequence.pause"), lower: 0, upper: MAX_PAUSE_S, unit: " s", digits: 1 }} text={String(waypoint.pause_s)} take={(pause_s) => edit({ pause_s })} />
          </label>
        </div>
      </Problems>
    </li>
  );
}

function checkText(check: LegCheck | undefined, units: UnitSystem): string {
  return inUnits(answerText(check), units);
}

function answerText(check: LegCheck | undefined): string {
  if (check === undefined || check.verdict === "checking") return t("sequence.checking");
  if (check.verdict === "unknown") return t("sequence.unknown", { message: check.message });
  if (check.verdict === "refused") return t("sequence.not_possible", { message: check.message });
  const possible = t("sequence.possible", { seconds: check.duration_s.toFixed(1) });
  return check.message === "" ? possible : `${possible} (${check.message})`;
}

/** Strip below the picture that is filled as far as the gripper is open there; none where the sequence does not set it. */
function GripperStrip({ own, index }: { own: string; index: number }): JSX.Element | null {
  const { state } = usePage().store;
  const gripper = armGripper(state);
  const share = gripper && openShare(state.sequence.waypoints, index, gripper);
  if (share === null) return null;
  const text = t("sequence.gripper.share", { percent: Math.round(100 * share) });
  return <div class="gripper-strip" data-testid={`${own}-strip`} role="img" title={text} aria-label={text}><i style={{ width: `${100 * share}%` }} /></div>;
}

/** Choice of the gripper's position after a leg; null leaves it as it is. */
function GripperChoice({ own, position, edit }: { own: string; position: number | null; edit: (patch: Partial<Waypoint>) => void }): JSX.Element {
  const { store } = usePage();
  const gripper = armGripper(store.state);
  const named = [["leave", t("sequence.gripper.leave"), null], ["open", t("sequence.gripper.open"), gripper?.open], ["closed", t("sequence.gripper.closed"), gripper?.closed]] as const;
  const known = named.find(([, , value]) => value === position);
  const other = known ? [] : [[String(position), t("sequence.gripper.at", { position: (position ?? 0).toFixed(2) })] as const];
  const take = (choice: string): void => {
    // Before the first joint state the gripper's position is not known.
    const present = currentPositions(store.state)[gripper?.joints[0] ?? ""] ?? null;
    const chosen = choice === "present" ? present : named.find(([value]) => value === choice)?.[2];
    edit({ gripper: chosen === undefined ? Number(choice) : chosen });
  };
  return (
    <label class="measure" hidden={gripper === null}>
      <span>{t("sequence.gripper")}</span>
      <Select testid={`${own}-gripper`} label={t("sequence.gripper")} value={known?.[0] ?? String(position)} options={[...named.map(([value, text]) => [value, text] as const), ["present", t("sequence.gripper.present")], ...other]} take={take} />
    </label>
  );
}

function PlayControls(): JSX.Element {
  const { store, sequencePlayer } = usePage();
  const { waypoints, playing, result, checks, loop } = store.state.sequence;
  const duration_s = waypoints.length === 0 ? null : sequenceDuration_s(waypoints, checks);
  const index = playing?.index ?? 0;
  const values = { number: index + 1, count: waypoints.length, name: waypoints[index]?.name ?? "" };
  return (
    <div>
      <div class="buttons">
        <Gate to="drive" moves><Button testid="play-sequence" title={t("sequence.play.title")} disabled={waypoints.length === 0 || playing !== null} press={() => void sequencePlayer.play()}>{t("sequence.play")}</Button></Gate>
        <Button testid="stop-sequence" disabled={playing === null} press={() => sequencePlayer.stop()}>{t("sequence.stop")}</Button>
        <Tick testid="sequence-loop" checked={loop} take={(on) => store.patch("sequence", { loop: on })} text={t("sequence.loop")} />
        <output data-testid="sequence-total">{duration_s === null ? "" : t("sequence.total", { seconds: duration_s.toFixed(1) })}</output>
      </div>
      <progress data-testid="sequence-progress" aria-label={t("sequence.progress")} hidden={playing === null} max={Math.max(1, waypoints.length)} value={index} />
      <p role="status" data-testid="sequence-told">{playing ? t(`sequence.doing.${playing.doing}`, values) : result}</p>
    </div>
  );
}
