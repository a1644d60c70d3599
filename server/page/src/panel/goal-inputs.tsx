import type { JSX } from "preact";
import { armGripper, armJoints, currentPositions, displayedPositions, isOneArm, jointKind, shownPosition, takesOrientation } from "../logic/joints";
import { distanceText, positionText, unitOf, type NumberRange, type Unit } from "../logic/numbers";
import { planningGroup } from "../logic/robot-info";
import { AXES, quaternionOf, rollPitchYawOf, ROTATIONS, type RollPitchYaw } from "../logic/rotations";
import type { Orientation, Point, State } from "../state/state";
import { selectGoal, selectTarget } from "../state/store";
import { t } from "../texts/texts";
import { Button, Gate, Line, NumberField, Problems, Section, Select, Slider, usePage, useSlowState } from "./ui";

/** Limit of typed coordinates [m], beyond the reach of any arm on a table or a mobile base. */
const MAX_COORDINATE_M = 5;

export function GroupChoice(): JSX.Element {
  const { store: { state }, commands } = usePage();
  const names = (state.robot?.groups ?? []).map(({ name }) => name);
  return (
    <Gate to="drive" hidden={names.length < 2}>
      <Line text={t("group.label")}>
        <Select testid="group" label={t("group.label")} value={planningGroup(state)?.name ?? ""} options={names.map((name) => [name, name])} take={(group) => commands.selectGroup(group)} />
      </Line>
    </Gate>
  );
}

export function Target(): JSX.Element {
  const { store } = usePage();
  const state = useSlowState();
  const { selection, target, settings: { units } } = state;
  const select = (position_m: Point, orientation: Orientation | null): void => {
    selectTarget(store, position_m, takesOrientation(store.state) ? orientation : null);
  };
  const move = (index: number, value_m: number): void => {
    select(targetPosition(store.state).with(index, value_m) as Point, targetOrientation(store.state));
  };
  const turn = (index: number, angle_rad: number): void => {
    const angles = rollPitchYawOf(targetOrientation(store.state)).with(index, angle_rad) as RollPitchYaw;
    select(targetPosition(store.state), quaternionOf(angles));
  };
  const position_m = targetPosition(state);
  const angles_rad = rollPitchYawOf(targetOrientation(state));
  const is_selected = selection.kind === "target";
  return (
    <Section name="target" title={t("target.title")} hidden={!isOneArm(state)}>
      <Problems>
        <div class="axes">
          {AXES.map((axis, index) => <UnitField key={axis} name={axis} limit={MAX_COORDINATE_M} unit={unitOf("prismatic", units)} value={position_m[index] ?? Number.NaN} take={(value) => move(index, value)} />)}
        </div>
        <div class="axes" hidden={!takesOrientation(state)}>
          {ROTATIONS.map(([name, limit], index) => <UnitField key={name} name={name} limit={limit} unit={unitOf("revolute", units)} value={angles_rad[index] ?? 0} take={(value) => turn(index, value)} />)}
        </div>
      </Problems>
      <p class="hint" data-testid="target-state" role="status" data-off={String(is_selected && target.reachable === false)}>{is_selected ? reachabilityText(state) : t("target.hint")}</p>
    </Section>
  );
}

interface UnitFieldProps {
  name: string;
  /** Limit to either side [m or rad]. */
  limit: number;
  unit: Unit;
  value: number;
  take: (value: number) => void;
}

function UnitField({ name, limit, unit, value, take }: UnitFieldProps): JSX.Element {
  const suffix = unit.suffix.trim();
  const range: NumberRange = { name, lower: -limit * unit.scale, upper: limit * unit.scale, unit: unit.suffix, digits: unit.digits };
  const text = Number.isFinite(value) ? positionText(value, unit) : "";
  return (
    <label>
      <b>{name}</b>
      <NumberField testid={`target-${name}`} label={t("target.axis.unit", { axis: name, unit: suffix })} range={range} text={text} take={(typed) => take(typed / unit.scale)} />
      <span class="unit" aria-hidden="true">{suffix}</span>
    </label>
  );
}

function targetPosition({ selection, target: { position_m }, tool_m }: State): Point {
  return (selection.kind === "target" ? position_m : tool_m) ?? [0, 0, 0];
}

function targetOrientation({ selection, target: { orientation }, tool_orientation }: State): Orientation {
  return (selection.kind === "target" ? orientation : null) ?? tool_orientation ?? [0, 0, 0, 1];
}

function reachabilityText({ target: { reachable, distance_m }, settings }: State): string {
  if (reachable === null) return "…";
  if (reachable) return t("target.reachable");
  if (distance_m > 0) return t("target.out_of_reach", { distance: distanceText(distance_m, settings.units) });
  return t("target.touches");
}

export function JointValuesSection(): JSX.Element {
  const { store } = usePage();
  const state = useSlowState();
  return (
    <Section name="joints" title={t("joints.title")}>
      <div class="rows" data-testid="joints">{armJoints(state).map((name) => <JointRow key={name} name={name} state={state} />)}</div>
      <Button testid="forget-wish" press={() => selectGoal(store, "none", null)}>{t("joints.back")}</Button>
    </Section>
  );
}

function JointRow({ name, state }: { name: string; state: State }): JSX.Element {
  const { store } = usePage();
  const kind = jointKind(state, name);
  const unit = unitOf(kind, state.settings.units);
  const { suffix, digits, step } = unit;
  const limits = state.limits[name] ?? [-Math.PI, Math.PI];
  const [lower, upper] = limits.map((limit) => limit * unit.scale) as [number, number];
  const take = (value: number): void => {
    const names = armJoints(store.state);
    const displayed = Object.entries(displayedPositions(store.state)).filter(([joint]) => names.includes(joint));
    selectGoal(store, "joints", { ...Object.fromEntries(displayed), [name]: value / unit.scale });
  };
  const position = (values: Record<string, number>): number => shownPosition(values[name] ?? Number.NaN, kind);
  const shown = position(displayedPositions(state));
  return (
    <div class="row">
      <Problems>
        <div class="row-head">
          <b>{name}</b>
          <span class="measured" data-testid={`joint-${name}-measured`} title={t("joints.measured")}>{`${positionText(position(currentPositions(state)), unit)}${suffix}`}</span>
          <NumberField testid={`joint-${name}-number`} label={t("joints.number", { name })} range={{ name, lower, upper, unit: suffix, digits }} text={positionText(shown, unit)} take={take} />
        </div>
        {/* A slider rounds to its steps and so may miss its limits; typing reaches them exactly. */}
        <Slider testid={`joint-${name}-slider`} label={t("joints.slider", { name })} range={[lower, upper, step]} value={shown * unit.scale} take={take} />
        <span class="limits" data-testid={`joint-${name}-limits`}>{kind === "continuous" ? t("joints.any") : `${positionText(limits[0], unit)} … ${positionText(limits[1], unit)}${suffix}`}</span>
      </Problems>
    </div>
  );
}

/** Positions between the ends of a gripper that its slider distinguishes. */
const GRIPPER_STEPS = 1000;

export function Gripper(): JSX.Element {
  const { commands } = usePage();
  const state = useSlowState();
  const gripper = armGripper(state);
  if (gripper === null) return <Section name="gripper" title={t("gripper.title")} hidden>{null}</Section>;
  const { open, closed } = gripper;
  const [lower, upper] = [Math.min(open, closed), Math.max(open, closed)];
  const finger = gripper.joints[0] ?? "";
  const position = currentPositions(state)[finger] ?? Number.NaN;
  const unit = unitOf(jointKind(state, finger), state.settings.units);
  return (
    <Section name="gripper" title={t("gripper.title")}>
      <Gate to="drive" moves>
        <div class="line">
          <Button testid="gripper-close" press={() => commands.moveGripper(closed)}>{t("gripper.close")}</Button>
          {/* Open is on the right, also where its position is the smaller number. */}
          <Slider testid="gripper" label={t("gripper.label")} range={[lower, upper, (upper - lower) / GRIPPER_STEPS]} value={position} dir={open < closed ? "rtl" : "ltr"} busy=":active, :focus" release={(value) => commands.moveGripper(value)} />
          <Button testid="gripper-open" press={() => commands.moveGripper(open)}>{t("gripper.open")}</Button>
          <output data-testid="gripper-measured">{`${positionText(position, unit)}${unit.suffix}`}</output>
        </div>
      </Gate>
    </Section>
  );
}
