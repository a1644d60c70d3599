import type { Commissioning, State, SweptJoint } from "../state/state";
import { t } from "../texts/texts";
import { currentPositions } from "./joints";

/** Ticks of a turn of a servo (STS3215). */
const TICKS_PER_TURN = 4096;

/** Motion that tells which joint the hand moves: a resting servo's reading varies by a tick or two. */
const HAND_TICKS = 8;

/**
 * Motion that tells the sign of a joint's ticks. Ticks and angles come by different topics, some 100 ms apart, in which
 * a hand may turn back: the longer the motion, the surer its sign.
 */
const SIGN_TICKS = 150;

/** Share of a motion in ticks by which the motion in radians may differ from it and still be the same motion. */
const SAME_MOTION = 0.5;

export function ticksToRadians(ticks: number): number {
  return (ticks / TICKS_PER_TURN) * 2 * Math.PI;
}

export function procedureTitle(procedure: string): string {
  if (procedure === "calibrate") return t("commissioning.calibration");
  return procedure === "verify" ? t("commissioning.verification") : procedure;
}

export interface BarPart {
  begin: number;
  width: number;
}

/** Bar of a joint's range: all values are fractions of its length, 0 to 1. */
export interface RangeBar {
  swept: BarPart;
  present: number;
  /** Width that is expected, about the middle of what has been swept; null where none is known. */
  expected: BarPart | null;
}

/** Room beside the expected range on each side, as a share of it: a range that is too wide is seen as such. */
const BAR_MARGIN = 0.15;

export function rangeBar({ lowest, present, highest, expected_width }: SweptJoint): RangeBar {
  const width = Math.max(highest - lowest, 0);
  const known = Math.max(expected_width, 0);
  // Without a known width the bar is a whole turn, within which every joint of a servo stays.
  const length = Math.max((known || TICKS_PER_TURN) * (1 + 2 * BAR_MARGIN), width);
  const begin = (lowest + highest) / 2 - length / 2;
  const at = (ticks: number): number => Math.min(Math.max((ticks - begin) / length, 0), 1);
  const expected = known === 0 ? null : { begin: (1 - known / length) / 2, width: known / length };
  return { swept: { begin: at(lowest), width: width / length }, present: at(present), expected };
}

function degrees(ticks: number): string {
  return `${Math.round((ticks / TICKS_PER_TURN) * 360)}°`;
}

/** Return what has been swept of a joint, as "157° of about 237°". */
export function rangeText({ lowest, highest, expected_width }: SweptJoint): string {
  const swept = degrees(Math.max(highest - lowest, 0));
  return expected_width > 0 ? t("commissioning.swept_of", { swept, expected: degrees(expected_width) }) : swept;
}

/** Return the droop of a joint in degrees; empty while it is not measured. */
export function droopText(droop_rad: number): string {
  return Number.isFinite(droop_rad) ? t("commissioning.droop", { angle: `${((droop_rad * 180) / Math.PI).toFixed(1)}°` }) : "";
}

/**
 * Return a key of the question that a state asks, which other answers change.
 *
 * An instruction may contain live figures: buttons that changed with each could not be pressed.
 */
export function questionOf({ procedure, step, answers }: Commissioning): string {
  return JSON.stringify([procedure, step, answers]);
}

/** Observer of the hand: which joint it moves, and with which sign the servo of that joint counts. */
export class HandObserver {
  private readonly marks = new Map<string, { ticks: number; position_rad: number }>();
  private readonly directions = new Map<string, 1 | -1>();
  private present = new Map<string, number>();
  private in_hand: string | null = null;

  /** Take a new state of the procedure, with the joint states of that time; return the joint in hand. */
  observe(commissioning: Commissioning, joints: State["joints"]): State["joint_in_hand"] {
    if (commissioning.procedure === "") return this.forget();
    const positions = currentPositions({ joints });
    for (const swept of commissioning.joints) this.learnDirection(swept, positions[swept.joint]);
    this.in_hand = this.movedMost(commissioning.joints) ?? this.in_hand;
    const is_known = commissioning.joints.some(({ joint }) => joint === this.in_hand);
    if (this.in_hand === null || !is_known) return null;
    return { joint: this.in_hand, direction: this.directions.get(this.in_hand) ?? 1 };
  }

  private forget(): null {
    this.marks.clear();
    // A calibration may have turned a joint's sign.
    this.directions.clear();
    this.present.clear();
    this.in_hand = null;
    return null;
  }

  private movedMost(joints: readonly SweptJoint[]): string | null {
    let [most, name] = [HAND_TICKS - 1, null as string | null];
    const next = new Map(this.present);
    for (const { joint, present } of joints) {
      const before = this.present.get(joint);
      const moved = before === undefined ? 0 : Math.abs(present - before);
      // A slow motion adds up until it is long enough.
      if (before === undefined || moved >= HAND_TICKS) next.set(joint, present);
      if (moved > most) [most, name] = [moved, joint];
    }
    this.present = next;
    return name;
  }

  private learnDirection({ joint, present }: SweptJoint, position_rad: number | undefined): void {
    if (position_rad === undefined) return;
    const mark = this.marks.get(joint);
    if (mark === undefined) return void this.marks.set(joint, { ticks: present, position_rad });
    const ticks = present - mark.ticks;
    if (Math.abs(ticks) < SIGN_TICKS) return;
    const turned_rad = position_rad - mark.position_rad;
    this.marks.set(joint, { ticks: present, position_rad });
    const expected_rad = ticksToRadians(Math.abs(ticks));
    if (Math.abs(Math.abs(turned_rad) - expected_rad) > SAME_MOTION * expected_rad) return;
    this.directions.set(joint, turned_rad * ticks > 0 ? 1 : -1);
  }
}
