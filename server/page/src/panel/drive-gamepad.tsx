import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import type { Services } from "../link/services";
import { DeadMan, gamepadCommands, isDeadManHeld, scaled, tipAxes } from "../logic/jog";
import { armJoints } from "../logic/joints";
import { t } from "../texts/texts";
import { useControls, type JogControls } from "./drive-controls";
import { Gate, Section, usePage } from "./ui";

/** Period of reading the gamepad [ms]: it has no events of its sticks. */
const POLL_PERIOD_MS = 16;

/** Driving by a gamepad, which moves nothing until it is switched on and a dead-man button is held. */
export function GamepadSection(): JSX.Element {
  const context = usePage();
  const controls = useControls();
  const [text, show] = useState("");
  const [reader] = useState(() => new GamepadReader(context, controls, show));
  useEffect(() => context.jogSender.onReleaseAll(() => reader.lock()), []);
  return (
    <Section name="drive-gamepad" title={t("drive.gamepad")} open={false}>
      <label class="line">
        <Gate to="drive"><input type="checkbox" data-testid="gamepad" onChange={({ currentTarget }) => (currentTarget.checked ? reader.start() : reader.stop())} /></Gate>
        {t("drive.gamepad.on")}
      </label>
      <p class="hint" data-testid="gamepad-state" role="status">{text}</p>
      <GamepadPicture />
    </Section>
  );
}

class GamepadReader {
  private timer: ReturnType<typeof setInterval> | undefined;
  private readonly dead_man = new DeadMan();
  private held: string[] = [];

  constructor(
    private readonly context: Services,
    private readonly controls: JogControls,
    private readonly show: (text: string) => void,
  ) {
    window.addEventListener("gamepaddisconnected", () => this.read());
  }

  start(): void {
    this.lock();
    this.timer ??= setInterval(() => this.read(), POLL_PERIOD_MS);
  }

  stop(): void {
    clearInterval(this.timer);
    this.timer = undefined;
    this.releaseExcept([]);
    this.show("");
  }

  /** Move nothing until the dead-man has been released and held again. */
  lock(): void {
    this.dead_man.lock();
  }

  private read(): void {
    if (this.timer === undefined) return;
    const connected = navigator.getGamepads().filter((pad) => pad?.connected === true);
    const pad = connected.find((each) => each?.mapping === "standard");
    if (!pad) {
      this.releaseExcept([]);
      this.dead_man.lock();
      const other = connected[0];
      return this.show(other ? t("drive.gamepad.mapping", { name: other.id }) : t("drive.gamepad.none"));
    }
    const is_held = isDeadManHeld(pad);
    const is_locked = !this.dead_man.counts(is_held) && is_held;
    const counts = is_held && !is_locked && document.hasFocus();
    this.show(t(counts ? "drive.gamepad.moving" : "drive.gamepad.ready", { name: pad.id }));
    const { store, jogSender } = this.context;
    // A dead-man that is locked, and held still, is an input that has not been let go.
    if (is_locked) return;
    const commands = counts ? gamepadCommands(pad, tipAxes(armJoints(store.state).length)) : [];
    this.releaseExcept(commands.map(({ kind }) => `gamepad ${kind}`));
    for (const command of commands) {
      jogSender.hold(`gamepad ${command.kind}`, scaled(command, this.controls.share()));
    }
    this.held = commands.map(({ kind }) => `gamepad ${kind}`);
  }

  private releaseExcept(inputs: readonly string[]): void {
    for (const input of this.held) if (!inputs.includes(input)) this.context.jogSender.release(input);
    this.held = this.held.filter((input) => inputs.includes(input));
  }
}

function GamepadPicture(): JSX.Element {
  const body = "M80 62 H260 C300 62 325 120 318 165 C312 192 285 188 262 150 H78 C55 188 28 192 22 165 C15 120 40 62 80 62 Z";
  const labels: [number, number, string][] = [
    [170, 53, t("drive.gamepad.dead_man")], [95, 53, "L1"], [245, 53, "R1"], [95, 28, `L2 ${t("drive.gamepad.down")}`], [245, 28, `R2 ${t("drive.gamepad.up")}`],
    [120, 132, "x  y"], [220, 126, t("drive.axis.roll")], [220, 138, t("drive.axis.pitch")], [74, 126, t("drive.axis.yaw")],
    [276, 110, "A"], [296, 92, "B"], [282, 128, t("drive.close")], [282, 76, t("drive.open")],
  ];
  return (
    <svg viewBox="0 0 340 200" class="gamepad-picture" role="img" aria-label={t("drive.gamepad.picture")}>
      {[60, 210].map((x) => <rect key={x} x={x} y={40} width={70} height={18} rx={8} class="dead-man" />)}
      <path d={body} />
      <path d="M68 84 H80 V92 H92 V104 H80 V112 H68 V104 H56 V92 H68 Z" />
      {[[120, 128, 20], [220, 128, 20], [276, 106, 9], [296, 88, 9]].map(([x, y, r]) => <circle key={x} cx={x} cy={y} r={r} />)}
      {labels.map(([x, y, text]) => <text key={`${x} ${y}`} x={x} y={y} text-anchor="middle">{text}</text>)}
    </svg>
  );
}
