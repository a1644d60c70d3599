import "./phone.css";
import { signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { PERIOD_MS, type JogSender } from "../link/servo-node";
import { denialReason } from "../logic/permissions";
import { PhoneFollower } from "../logic/phone-follower";
import type { PageStore } from "../state/store";
import { t, type TextKey } from "../texts/texts";
import { AccessCode } from "./access-code";
import { isTouch } from "./drive-pads";
import { useHold, useStored, useStoredNumber, watchThumb } from "./drive-controls";
import { canTrackPosition, SourceError, startOrientation, startTracking, type PoseSource } from "../link/phone-sources";
import { Button, Gate, Line, Section, Select, Slider, usePage } from "./ui";

const INPUT = "phone";

/** Shares of the phone's way that the tip goes, from fine to coarse. */
const SCALES = [0.1, 0.25, 0.5, 1, 2] as const;

/** Way of the thumb on the pad for full speed [px]. */
const PAD_PX = 80;

/** Meaning of tilting and turning where the phone's position is not known. */
const MODES = ["tilt", "turn"] as const;
type Mode = (typeof MODES)[number];

export function PhoneSection(): JSX.Element {
  const code = <AccessCode name="phone" role="" text={t("phone.show_code")} />;
  return (
    <Section name="phone" title={t("phone")} open={isTouch()}>
      {/* On the phone its controls come first, elsewhere the code that brings the page onto the phone. */}
      {!isTouch() && code}
      <PhoneController />
      {isTouch() && code}
    </Section>
  );
}

function PhoneController(): JSX.Element {
  const { store, jogSender } = usePage();
  const [driver] = useState(() => new PhoneDriver(store, jogSender));
  const [mode, setMode] = useStored("phone-mode", MODES);
  const [can_track, setCanTrack] = useState(false);
  const [scale, chooseScale] = useStoredNumber("phone-scale", 2);
  useLayoutEffect(() => driver.setMode(mode), [mode]);
  useLayoutEffect(() => void (driver.follower.scale = SCALES[scale] ?? 1), [scale]);
  useEffect(() => {
    void canTrackPosition().then(setCanTrack);
    jogSender.onReleaseAll(() => driver.open());
  }, []);
  const clutch = useHold<HTMLButtonElement>(() => driver.grip(), () => driver.release());
  const source = driver.source.value;
  const is_held = driver.gripping.value;
  const hint: TextKey = !source ? "phone.hint" : source.tracks_position ? "phone.hint.move" : `phone.hint.${mode}`;
  return (
    <div class="phone-controller" data-testid="phone-controller" data-started={String(source !== null)} data-tracks={String(source?.tracks_position ?? false)}>
      <div class="buttons">
        <Button testid="phone-track" hidden={!can_track} press={() => void driver.start(() => startTracking(driver.take, () => driver.end()))}>{t("phone.track")}</Button>
        <Button testid="phone-start" press={() => void driver.start(() => startOrientation(driver.take))}>{t("phone.start")}</Button>
        <Button testid="phone-end" press={() => driver.end()}>{t("phone.end")}</Button>
      </div>
      <p class="hint" data-testid="phone-status" role="status">{driver.problem.value || t(hint)}</p>
      <Gate to="drive">
        <button ref={clutch} type="button" class="phone-clutch" data-testid="phone-clutch" disabled={source === null}>{t(is_held ? "phone.clutch.held" : "phone.clutch")}</button>
        <PhonePad driver={driver} />
        <Line text={t("phone.scale.fine")}>
          <Slider testid="phone-scale" label={t("phone.scale")} range={[0, SCALES.length - 1, 1]} value={scale} take={chooseScale} /> {t("phone.scale.coarse")} <output data-testid="phone-scale-value">{`${SCALES[scale] ?? 1} : 1`}</output>
        </Line>
        <label class="line phone-mode">{t("phone.mode")} <Select testid="phone-mode" value={mode} options={MODES.map((each) => [each, t(`phone.mode.${each}`)])} take={setMode} /></label>
      </Gate>
    </div>
  );
}

function PhonePad({ driver }: { driver: PhoneDriver }): JSX.Element {
  const pad = useRef<HTMLDivElement>(null);
  useLayoutEffect(() => {
    const limited = (way_px: number): number => Math.max(-1, Math.min(1, way_px / PAD_PX));
    const move = (right_px: number, down_px: number): void => void (driver.thumb.value = { right: limited(right_px), up: limited(-down_px) });
    if (pad.current) watchThumb(pad.current, move, () => move(0, 0));
  }, []);
  const { right, up } = driver.thumb.value;
  return <div ref={pad} class="phone-pad" data-testid="phone-pad" role="img" aria-label={t("phone.pad")}><i style={{ transform: `translate(${right * PAD_PX}px, ${-up * PAD_PX}px)` }} /></div>;
}

class PhoneDriver {
  readonly source = signal<PoseSource | null>(null);
  readonly gripping = signal(false);
  readonly problem = signal("");
  readonly thumb = signal({ right: 0, up: 0 });
  readonly follower: PhoneFollower;
  readonly take: PhoneFollower["update"];
  private mode: Mode = "tilt";
  private timer: ReturnType<typeof setInterval> | undefined;
  /** Frame that is chosen for the other inputs, while the clutch is held. */
  private chosen_frame: JogSender["frame"] = "base";

  constructor(
    private readonly store: PageStore,
    private readonly jogSender: JogSender,
  ) {
    this.follower = new PhoneFollower(() => {
      const { linear_scale, rotational_scale } = store.state.servo_node;
      return { linear_m_s: linear_scale, angular_rad_s: rotational_scale };
    });
    this.take = this.follower.update.bind(this.follower);
  }

  async start(source: () => Promise<PoseSource>): Promise<void> {
    this.end();
    this.problem.value = t("phone.starting");
    try {
      this.source.value = await source();
      this.setMode(this.mode);
      this.problem.value = "";
    } catch (error) {
      this.problem.value = error instanceof SourceError ? t(error.key) : t("phone.failed", { reason: (error as Error).message });
    }
  }

  end(): void {
    this.release();
    this.source.peek()?.stop();
    this.source.value = null;
    this.problem.value = "";
  }

  setMode(mode: Mode): void {
    this.release();
    this.mode = mode;
    const source = this.source.peek();
    if (source) this.follower.mode = source.tracks_position ? "move" : mode;
  }

  grip(): void {
    if (!this.isAllowed() || !this.follower.grip(performance.now())) return;
    this.gripping.value = true;
    // The phone's axes are those of the person who holds it, not the tool's.
    this.chosen_frame = this.jogSender.frame;
    this.jogSender.frame = "base";
    clearInterval(this.timer);
    this.timer = setInterval(() => this.send(), PERIOD_MS);
  }

  release(): void {
    this.open();
    this.jogSender.release(INPUT);
  }

  /** Open the clutch, which must be let go and held again. */
  open(): void {
    if (!this.follower.gripping) return;
    this.follower.release();
    clearInterval(this.timer);
    this.gripping.value = false;
    this.jogSender.frame = this.chosen_frame;
  }

  private send(): void {
    if (!this.isAllowed()) return this.release();
    const now_ms = performance.now();
    const velocity = this.follower.velocity(now_ms);
    if (this.follower.mode !== "move" && this.follower.isTracked(now_ms)) {
      const { right, up } = this.thumb.peek();
      const share = Math.min(1, this.follower.scale);
      if (this.follower.mode === "tilt") velocity.z = up * share;
      else {
        velocity.x = up * share;
        velocity.y = -right * share;
      }
    }
    this.jogSender.hold(INPUT, { kind: "tip", velocity });
  }

  private isAllowed(): boolean {
    const { state } = this.store;
    return state.link.connected && denialReason("drive", state) === "";
  }
}
