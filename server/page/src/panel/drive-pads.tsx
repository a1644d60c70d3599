import { signal, type Signal } from "@preact/signals";
import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { isRotation, LEFT_PAD, padCommand, rightPad, scaled, tipAxes, type PadAxes, type TipAxis } from "../logic/jog";
import { armJoints } from "../logic/joints";
import { t } from "../texts/texts";
import { axisText, useControls, useHold, useStored, watchThumb, type JogControls } from "./drive-controls";
import { Gate, Line, Section, usePage } from "./ui";
import type { JogSender } from "../link/servo-node";

const ROTATION_AXES = ["pitch", "roll", "yaw"] as const satisfies readonly TipAxis[];

export function isTouch(): boolean {
  return matchMedia("(pointer: coarse)").matches;
}

/** Two pads for thumbs, which move nothing while neither bar below them is held. */
export function PadsSection({ lying }: { lying: boolean }): JSX.Element {
  const { store, jogSender } = usePage();
  const controls = useControls();
  const [chosen, choose] = useStored("pad-rotation", ROTATION_AXES);
  const offered = tipAxes(armJoints(store.state).length).filter(isRotation);
  const rotation = offered.includes(chosen) ? chosen : (offered[0] ?? null);
  const [held] = useState(() => new Set<string>());
  const isHeld = (): boolean => held.size > 0;
  const [left] = useState(() => new ThumbPad("pad-left", jogSender, controls, isHeld));
  const [right] = useState(() => new ThumbPad("pad-right", jogSender, controls, isHeld));
  right.axes = rightPad(rotation);
  // After a stop the bars must be let go and held again.
  useEffect(() => jogSender.onReleaseAll(() => held.clear()), []);
  const hold = (bar: string): void => {
    held.add(bar);
    for (const pad of [left, right]) pad.apply();
  };
  const release = (bar: string): void => {
    held.delete(bar);
    if (!isHeld()) for (const { testid } of [left, right]) jogSender.release(testid);
  };
  const axis = rotation ? axisText(rotation) : "–";
  return (
    <Section name="drive-pads" title={t("drive.pads")} open={isTouch()} force={lying}>
      <Gate to="drive" moves>
        <div class="pads">
          <div class="pad-side"><Pad pad={left} label={t("drive.pads.left")} caption="x ↕  y ↔" /><DeadMan testid="dead-man-left" hold={hold} release={release} /></div>
          <div class="pad-side"><Pad pad={right} label={t("drive.pads.right", { axis })} caption={`z ↕  ${axis} ↔`} /><DeadMan testid="dead-man-right" hold={hold} release={release} /></div>
        </div>
      </Gate>
      <p class="hint">{t("drive.pads.hint")}</p>
      <Line text={t("drive.pads.rotation")}>
        <select data-testid="pad-rotation" aria-label={t("drive.pads.rotation")} value={rotation ?? chosen} disabled={rotation === null} onChange={({ currentTarget }) => choose(currentTarget.value)}>
          {ROTATION_AXES.map((each) => <option key={each} value={each} disabled={!offered.includes(each)} hidden={!offered.includes(each)}>{axisText(each)}</option>)}
        </select>
      </Line>
    </Section>
  );
}

/** Pad for one thumb, whose way counts from where it has landed. */
class ThumbPad {
  axes: PadAxes = LEFT_PAD;
  /** Place in the pad where the thumb has landed, the middle before that, and its way from there [px]. */
  readonly thumb: Signal<{ at?: { left: string; top: string }; right: number; down: number }> = signal({ right: 0, down: 0 });
  private landed = false;

  constructor(
    readonly testid: string,
    private readonly jogSender: JogSender,
    private readonly controls: JogControls,
    private readonly isHeld: () => boolean,
  ) {}

  apply(): void {
    if (!this.landed || !this.isHeld()) return;
    const { right, down } = this.thumb.peek();
    const command = padCommand(this.axes, right, down);
    if (Object.keys(command.velocity).length === 0) this.jogSender.release(this.testid);
    else this.jogSender.hold(this.testid, scaled(command, this.controls.share()));
  }

  listen(element: HTMLElement): void {
    const move = (right: number, down: number): void => void (this.thumb.value = { ...this.thumb.peek(), right, down });
    watchThumb(
      element,
      (right_px, down_px) => {
        move(right_px, down_px);
        this.apply();
      },
      () => {
        this.landed = false;
        move(0, 0);
        this.jogSender.release(this.testid);
      },
      ({ clientX, clientY }) => {
        const { left, top } = element.getBoundingClientRect();
        this.landed = true;
        this.thumb.value = { at: { left: `${clientX - left}px`, top: `${clientY - top}px` }, right: 0, down: 0 };
      },
    );
  }
}

function Pad({ pad, label, caption }: { pad: ThumbPad; label: string; caption: string }): JSX.Element {
  const element = useRef<HTMLDivElement>(null);
  useLayoutEffect(() => void (element.current && pad.listen(element.current)), []);
  const { at, right, down } = pad.thumb.value;
  return (
    <div ref={element} class="pad" data-testid={pad.testid} role="img" aria-label={label}>
      <i style={{ ...at, transform: `translate(${right}px, ${down}px)` }} />
      <span>{caption}</span>
    </div>
  );
}

function DeadMan({ testid, hold, release }: { testid: string; hold: (bar: string) => void; release: (bar: string) => void }): JSX.Element {
  const bar = useHold<HTMLButtonElement>(() => hold(testid), () => release(testid));
  return <button ref={bar} type="button" class="pad-dead-man" data-testid={testid}>{t("drive.pads.dead_man")}</button>;
}
