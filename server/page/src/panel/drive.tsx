import "./drive.css";
import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { isRotation, scaled, tipAxes, type JogCommand, type TipAxis } from "../logic/jog";
import { armGripper, armJoints, isOneArm, jointKind } from "../logic/joints";
import type { State } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { axisText, Controls, useControls, useHold, useStored, useStoredNumber, type JogControls } from "./drive-controls";
import { GamepadSection } from "./drive-gamepad";
import { KeyboardSection } from "./drive-keyboard";
import { isTouch, PadsSection } from "./drive-pads";
import { PhoneSection } from "./phone";
import { Gate, Line, Section, Select, Slider, usePage } from "./ui";

/** Sizes of a step: of the tip and joints that slide, of turning, and of the gripper as a share of its range. */
const STEPS = [
  { length_mm: 1, angle_deg: 1, opening: 0.02 },
  { length_mm: 5, angle_deg: 5, opening: 0.1 },
  { length_mm: 20, angle_deg: 15, opening: 0.3 },
] as const;

/** A phone on its side: the pads stand left and right of the picture, and the rest is folded (drive.css). */
const LYING = matchMedia("(max-height: 500px) and (pointer: coarse)");

export function Drive(): JSX.Element {
  const { store, jogSender, jogSteps } = usePage();
  const [lying, lie] = useState(LYING.matches);
  const [mode, setMode] = useStored("drive-mode", ["hold", "0", "1", "2"]);
  const [speed, chooseSpeed] = useStoredNumber("drive-speed", 0.5);
  // Inputs are read outside of the drawing.
  const newest = useRef({ mode, speed });
  newest.current = { mode, speed };
  useEffect(() => {
    const turn = (): void => lie(LYING.matches);
    LYING.addEventListener("change", turn);
    // A key or finger that is released elsewhere is not reported to this page.
    const leave = (): void => jogSender.leave();
    for (const event of ["blur", "pagehide"]) window.addEventListener(event, leave);
    document.addEventListener("visibilitychange", leave);
  }, []);
  const step = (command: JogCommand): void => {
    const size = stepSize(store.state, command, STEPS[Number(newest.current.mode) || 0] ?? STEPS[0]);
    jogSteps.step(command, size, newest.current.speed);
  };
  const press = (input: string, command: JogCommand): void => {
    if (newest.current.mode === "hold") jogSender.hold(input, scaled(command, newest.current.speed));
    else step(command);
  };
  const [controls] = useState<JogControls>({ share: () => newest.current.speed, press, step, release: (input) => jogSender.release(input) });
  const chooseMode = (value: string): void => {
    setMode(value);
    jogSender.releaseAll();
  };
  const pads = <PadsSection lying={lying} />;
  return (
    <div class="drive" data-testid="section-drive">
      <StatusLine />
      <Controls.Provider value={controls}>
        <div hidden={!isOneArm(store.state)}>
          {/* On a touch screen the pads come first, where the thumbs are. */}
          {isTouch() && pads}
          <details class="drive-rest" data-testid="drive-rest" open={!lying}>
            <summary>{t("drive.more")}</summary>
            <div class="drive-settings">
              <Line text={t("drive.mode")}>
                <Select
                  testid="drive-mode" label={t("drive.mode")} value={mode} take={chooseMode}
                  options={[["hold", t("drive.mode.hold")], ...STEPS.map(({ length_mm, angle_deg }, index) => [String(index), t("drive.mode.step", { length: length_mm, angle: angle_deg })] as const)]}
                />
              </Line>
              <FrameLine />
              <SpeedLine speed={speed} choose={chooseSpeed} />
            </div>
            <Gate to="drive" moves>
              <Section name="drive-tip" title={t("drive.tip")}><JogGrid rows={tipRows(store.state)} /></Section>
              <Section name="drive-joints" title={t("drive.joints")}><JogGrid kind="wide-names" rows={jointRows(store.state)} /></Section>
            </Gate>
            {!isTouch() && pads}
            <KeyboardSection />
            <GamepadSection />
            <PhoneSection />
          </details>
        </div>
      </Controls.Provider>
    </div>
  );
}

function FrameLine(): JSX.Element {
  const { jogSender } = usePage();
  const [frame, setFrame] = useStored("drive-frame", ["base", "tool"]);
  useLayoutEffect(() => void (jogSender.frame = frame), [frame]);
  return <Line text={t("drive.frame")}><Select testid="drive-frame" label={t("drive.frame")} value={frame} options={[["base", t("drive.frame.base")], ["tool", t("drive.frame.tool")]]} take={setFrame} /></Line>;
}

function SpeedLine({ speed, choose }: { speed: number; choose: (speed: number) => void }): JSX.Element {
  const { linear_scale, rotational_scale } = usePage().store.state.servo_node;
  const angular = Math.round((rotational_scale * speed * 180) / Math.PI);
  return (
    <Line text={t("drive.speed")}>
      <Slider testid="jog-speed" id="jog-speed" range={[0.1, 1, 0.1]} value={speed} take={choose} />
      <output data-testid="drive-speed-value">{t("drive.speed.value", { linear: Math.round(linear_scale * speed * 1000), angular })}</output>
    </Line>
  );
}

function stepSize(state: State, { kind, velocity }: JogCommand, step: (typeof STEPS)[number]): number {
  if (kind === "gripper") return step.opening;
  const name = Object.keys(velocity)[0] ?? "";
  const turns = kind === "joints" ? jointKind(state, name) !== "prismatic" : isRotation(name as TipAxis);
  return turns ? (step.angle_deg * Math.PI) / 180 : step.length_mm / 1000;
}

/** Line that says what limits the arm; a message without a code is what of the command was given up. */
function StatusLine(): JSX.Element {
  const { state } = usePage().store;
  const { code, message } = state.servo_node;
  const words = code !== 0 && code >= -1 && code <= 6 ? t(`drive.status.${code}` as TextKey) : "";
  const text = code === 0 ? message || t("drive.hint") : `${words} ${message}`.trim();
  return <p class="drive-status" data-testid="drive-status" role="status" data-code={code}>{isOneArm(state) ? text : t("drive.one_arm")}</p>;
}

interface JogRow {
  id: string;
  name: string;
  /** Command of the button that raises; the other one has the opposite. */
  command: JogCommand;
  texts: readonly [string, string];
}

const SIGNS = ["−", "+"] as const;

function tipRows(state: State): JogRow[] {
  return tipAxes(armJoints(state).length).map((axis) => ({ id: `jog-${axis}`, name: axisText(axis), command: { kind: "tip", velocity: { [axis]: 1 } }, texts: SIGNS }));
}

function jointRows(state: State): JogRow[] {
  const rows = armJoints(state).map((name): JogRow => ({ id: `jog-${name}`, name, command: { kind: "joints", velocity: { [name]: 1 } }, texts: SIGNS }));
  if (armGripper(state) === null) return rows;
  const texts = [t("drive.close"), t("drive.open")] as const;
  return [...rows, { id: "jog-gripper", name: t("drive.gripper"), command: { kind: "gripper", velocity: { opening: 1 } }, texts }];
}

/** Grid of rows; a button that is held keeps its element, and is let go where its row is gone. */
function JogGrid({ rows, kind = "" }: { rows: readonly JogRow[]; kind?: string }): JSX.Element {
  const { jogSender } = usePage();
  const ids = rows.map(({ id }) => id).join();
  useLayoutEffect(() => jogSender.releaseAll(), [ids]);
  return (
    <div class={`jog-grid ${kind}`}>
      {rows.map(({ id, name, command, texts: [less, more] }) => (
        <div key={`${id} ${name}`} class="jog-row">
          <span title={name}>{name}</span>
          <HoldButton text={less} label={less === "−" ? t("drive.minus", { name }) : `${name}: ${less}`} testid={`${id}-minus`} command={scaled(command, -1)} />
          <HoldButton text={more} label={more === "+" ? t("drive.plus", { name }) : `${name}: ${more}`} testid={`${id}-plus`} command={command} />
        </div>
      ))}
    </div>
  );
}

function HoldButton({ text, label, testid, command }: { text: string; label: string; testid: string; command: JogCommand }): JSX.Element {
  const controls = useControls();
  const button = useHold<HTMLButtonElement>(() => controls.press(testid, command), () => controls.release(testid));
  // A screen reader's press has no release, and no pointer either.
  const click = ({ detail, isTrusted }: MouseEvent): void => void (detail === 0 && isTrusted && controls.step(command));
  return <button ref={button} type="button" class="hold" aria-label={label} data-testid={testid} onClick={click}>{text}</button>;
}
