import { armJoints } from "../logic/joints";
import { scaled, tipAxes } from "../logic/jog";
import { DeadMan, gamepadCommands, isDeadManHeld } from "../logic/jog-gamepad";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { el, section, setText, svg } from "./dom";
import type { JogControls } from "./drive-controls";

/** Period of reading the gamepad [ms]: it has no events of its sticks. */
const POLL_PERIOD_MS = 16;

/** Create the section of the gamepad, which moves nothing until it is switched on and a dead-man button is held. */
export function gamepadSection(context: PanelContext, controls: JogControls): HTMLElement {
  const { jogSender } = context;
  const on = el("input", { type: "checkbox", testid: "gamepad" });
  const state = el("p", { class: "hint", testid: "gamepad-state", role: "status" });
  const reader = new GamepadReader(context, controls, (text) => setText(state, text));
  on.addEventListener("change", () => (on.checked ? reader.start() : reader.stop()));
  jogSender.onReleaseAll(() => reader.lock());
  const line = el("label", { class: "line" }, permissionFieldset(context, "drive", on), t("drive.gamepad.on"));
  return section("drive-gamepad", t("drive.gamepad"), false, line, state, gamepadPicture());
}

/** Reader of the first gamepad with the standard mapping. */
class GamepadReader {
  private timer: ReturnType<typeof setInterval> | undefined;
  private readonly dead_man = new DeadMan();
  private held: string[] = [];

  constructor(
    private readonly context: PanelContext,
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

/** Draw a gamepad with what its parts do. */
function gamepadPicture(): SVGElement {
  const picture = svg("svg", { viewBox: "0 0 340 200", class: "gamepad-picture", role: "img", "aria-label": t("drive.gamepad.picture") });
  const label = (x: number, y: number, text: string): SVGElement => svg("text", { x, y, "text-anchor": "middle" }, text);
  const body = "M80 62 H260 C300 62 325 120 318 165 C312 192 285 188 262 150 H78 C55 188 28 192 22 165 C15 120 40 62 80 62 Z";
  picture.append(
    svg("rect", { x: 60, y: 40, width: 70, height: 18, rx: 8, class: "dead-man" }),
    svg("rect", { x: 210, y: 40, width: 70, height: 18, rx: 8, class: "dead-man" }),
    label(170, 53, t("drive.gamepad.dead_man")),
    label(95, 53, "L1"),
    label(245, 53, "R1"),
    label(95, 28, `L2 ${t("drive.gamepad.down")}`),
    label(245, 28, `R2 ${t("drive.gamepad.up")}`),
    svg("path", { d: body }),
    svg("circle", { cx: 120, cy: 128, r: 20 }),
    label(120, 132, "x  y"),
    svg("circle", { cx: 220, cy: 128, r: 20 }),
    label(220, 126, t("drive.axis.roll")),
    label(220, 138, t("drive.axis.pitch")),
    svg("path", { d: "M68 84 H80 V92 H92 V104 H80 V112 H68 V104 H56 V92 H68 Z" }),
    label(74, 126, t("drive.axis.yaw")),
    svg("circle", { cx: 276, cy: 106, r: 9 }),
    label(276, 110, "A"),
    svg("circle", { cx: 296, cy: 88, r: 9 }),
    label(296, 92, "B"),
    label(282, 128, t("drive.close")),
    label(282, 76, t("drive.open")),
  );
  return picture;
}
