import { PERIOD_MS, type JogSender } from "../link/servo-node";
import { PhoneFollower, type PhoneMode } from "../logic/phone-follower";
import { denialReason } from "../logic/permissions";
import { t, type TextKey } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, loadPreference, option, setText, storePreference } from "./dom";
import { watchHold, watchPointer } from "./drive-controls";
import { canTrackPosition, SourceError, startOrientation, startTracking, type PoseSource } from "./phone-sources";

/** Name of this input among those that drive the arm. */
const INPUT = "phone";

/** Shares of the phone's way that the tip goes, from fine to coarse. */
const SCALES = [0.1, 0.25, 0.5, 1, 2] as const;

/** Way of the thumb on the pad for full speed [px]. */
const PAD_PX = 80;

/** Create the controls with which the phone that shows them moves the tip. */
export function phoneController(context: PanelContext): HTMLElement {
  return new PhoneController(context).element;
}

class PhoneController {
  readonly element: HTMLElement;
  private readonly follower: PhoneFollower;
  private readonly status = el("p", { class: "hint", testid: "phone-status", role: "status" });
  private readonly clutch = el("button", { type: "button", class: "phone-clutch", testid: "phone-clutch" });
  private readonly modes = el("select", { testid: "phone-mode" });
  private readonly pad = el("div", { class: "phone-pad", testid: "phone-pad", role: "img" }, el("i", {}));
  private source: PoseSource | null = null;
  private timer: ReturnType<typeof setInterval> | undefined;
  /** Share of the thumb's way on the pad, to the right and up. */
  private thumb = { right: 0, up: 0 };

  /** Frame that is chosen for the other inputs, while the clutch is held. */
  private chosen_frame: JogSender["frame"] = "base";

  constructor(private readonly context: PanelContext) {
    const { store } = context;
    this.follower = new PhoneFollower(() => {
      const { linear_scale, rotational_scale } = store.state.servo_node;
      return { linear_m_s: linear_scale, angular_rad_s: rotational_scale };
    });
    const take = this.follower.update.bind(this.follower);
    const tilt = button(t("phone.start"), "phone-start", () => void this.start(() => startOrientation(take)));
    const track = button(t("phone.track"), "phone-track", () => void this.start(() => startTracking(take, () => this.end())));
    const end = button(t("phone.end"), "phone-end", () => this.end());
    track.hidden = true;
    void canTrackPosition().then((can) => (track.hidden = !can));
    watchHold(this.clutch, () => this.grip(), () => this.release());
    const controls = permissionFieldset(context, "drive", this.clutch, this.padOf(), scaleLine(this.follower), this.modeLine());
    this.element = el("div", { class: "phone-controller", testid: "phone-controller" });
    this.element.append(el("div", { class: "buttons" }, track, tilt, end), this.status, controls);
    context.jogSender.onReleaseAll(() => this.open());
    this.show();
  }

  private async start(source: () => Promise<PoseSource>): Promise<void> {
    this.end();
    setText(this.status, t("phone.starting"));
    try {
      this.source = await source();
      this.follower.mode = this.source.tracks_position ? "move" : (this.modes.value as PhoneMode);
      this.show();
    } catch (error) {
      this.show(error instanceof SourceError ? t(error.key) : t("phone.failed", { reason: (error as Error).message }));
    }
  }

  private end(): void {
    this.release();
    const { source } = this;
    this.source = null;
    source?.stop();
    this.show();
  }

  private show(problem = ""): void {
    const hint: TextKey = !this.source ? "phone.hint" : this.source.tracks_position ? "phone.hint.move" : `phone.hint.${this.modes.value as "tilt" | "turn"}`;
    setText(this.status, problem || t(hint));
    this.element.dataset["started"] = String(this.source !== null);
    this.element.dataset["tracks"] = String(this.source?.tracks_position ?? false);
    this.clutch.disabled = this.source === null;
    setText(this.clutch, t(this.follower.gripping ? "phone.clutch.held" : "phone.clutch"));
  }

  /** Create the choice of what tilting and turning do where the phone's position is not known. */
  private modeLine(): HTMLElement {
    for (const mode of ["tilt", "turn"] as const) {
      this.modes.append(option(mode, t(`phone.mode.${mode}`)));
    }
    this.modes.value = loadPreference("phone-mode", "tilt") === "turn" ? "turn" : "tilt";
    this.modes.addEventListener("change", () => {
      this.release();
      storePreference("phone-mode", this.modes.value);
      if (this.source && !this.source.tracks_position) this.follower.mode = this.modes.value as PhoneMode;
      this.show();
    });
    return el("label", { class: "line phone-mode" }, `${t("phone.mode")} `, this.modes);
  }

  /** Create the pad for the other thumb, for the axes that the phone's motion leaves. */
  private padOf(): HTMLElement {
    const { pad } = this;
    pad.setAttribute("aria-label", t("phone.pad"));
    let landed = { x: 0, y: 0 };
    const knob = pad.querySelector("i");
    const set = (right: number, up: number): void => {
      const limited = (share: number): number => Math.max(-1, Math.min(1, share));
      this.thumb = { right: limited(right), up: limited(up) };
      if (knob) knob.style.transform = `translate(${this.thumb.right * PAD_PX}px, ${-this.thumb.up * PAD_PX}px)`;
    };
    const move = ({ clientX, clientY }: PointerEvent): void => set((clientX - landed.x) / PAD_PX, (landed.y - clientY) / PAD_PX);
    watchPointer(pad, ({ clientX: x, clientY: y }) => void (landed = { x, y }), () => set(0, 0), move);
    return pad;
  }

  private grip(): void {
    if (!this.isAllowed() || !this.follower.grip(performance.now())) return;
    this.clutch.dataset["held"] = "true";
    // The phone's axes are those of whoever holds it, not the tool's.
    this.chosen_frame = this.context.jogSender.frame;
    this.context.jogSender.frame = "base";
    clearInterval(this.timer);
    this.timer = setInterval(() => this.send(), PERIOD_MS);
    this.show();
  }

  private release(): void {
    this.open();
    this.context.jogSender.release(INPUT);
  }

  /** Open the clutch, which must be let go and held again. */
  private open(): void {
    if (!this.follower.gripping) return;
    this.follower.release();
    clearInterval(this.timer);
    delete this.clutch.dataset["held"];
    this.context.jogSender.frame = this.chosen_frame;
    this.show();
  }

  private send(): void {
    if (!this.isAllowed()) return this.release();
    const now_ms = performance.now();
    const velocity = this.follower.velocity(now_ms);
    if (this.follower.mode !== "move" && this.follower.isTracked(now_ms)) {
      const { right, up } = this.thumb;
      if (this.follower.mode === "tilt") velocity.z = up * Math.min(1, this.follower.scale);
      else {
        velocity.x = up * Math.min(1, this.follower.scale);
        velocity.y = -right * Math.min(1, this.follower.scale);
      }
    }
    this.context.jogSender.hold(INPUT, { kind: "tip", velocity });
  }

  private isAllowed(): boolean {
    const { state } = this.context.store;
    return state.link.connected && denialReason("drive", state) === "";
  }
}

/** Create the slider between fine and coarse. */
function scaleLine(follower: PhoneFollower): HTMLElement {
  const attributes = { min: "0", max: String(SCALES.length - 1), step: "1" };
  const slider = el("input", { type: "range", testid: "phone-scale", label: t("phone.scale"), attributes });
  const shown = el("output", { testid: "phone-scale-value" });
  slider.value = loadPreference("phone-scale", "2");
  const apply = (): void => {
    follower.scale = SCALES[Number(slider.value)] ?? 1;
    setText(shown, `${follower.scale} : 1`);
  };
  slider.addEventListener("input", () => {
    storePreference("phone-scale", slider.value);
    apply();
  });
  apply();
  return el("label", { class: "line" }, `${t("phone.scale.fine")} `, slider, ` ${t("phone.scale.coarse")} `, shown);
}
