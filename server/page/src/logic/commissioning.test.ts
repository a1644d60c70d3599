import { describe, expect, it } from "vitest";
import { emptyState, type Commissioning, type Joints, type SweptJoint } from "../state/state";
import { droopText, HandObserver, questionOf, rangeBar, rangeText, ticksToRadians } from "./commissioning";

const joint = (patch: Partial<SweptJoint> = {}): SweptJoint => ({
  joint: "elbow",
  lowest: 1000,
  present: 1500,
  highest: 2000,
  expected_width: 2000,
  done: false,
  note: "",
  droop_rad: Number.NaN,
  ...patch,
});

const state = (patch: Partial<Commissioning> = {}): Commissioning => ({
  procedure: "calibrate",
  step: "sweep",
  instruction: "Move it.",
  answers: ["done"],
  progress: 0.5,
  joints: [joint()],
  findings: [],
  result: "",
  ...patch,
});

describe("rangeBar", () => {
  it("puts the swept range, the present position and the expected width where they belong", () => {
    const bar = rangeBar(joint({ present: 2000 }));
    expect(bar.swept.begin + bar.swept.width / 2).toBeCloseTo(0.5);
    expect(bar.present).toBeCloseTo(bar.swept.begin + bar.swept.width);
    expect(bar.expected?.width).toBeCloseTo(2 * bar.swept.width);
    expect(bar.expected!.begin + bar.expected!.width / 2).toBeCloseTo(0.5);
  });
  it("stays within its length for a range that is far too wide", () => {
    const bar = rangeBar(joint({ lowest: -3000, highest: 6000, present: 6000 }));
    expect([bar.swept.begin, bar.swept.width, bar.present]).toEqual([0, 1, 1]);
    expect(bar.expected!.begin).toBeGreaterThan(0);
  });
  it("shows a joint that has not moved as a point in the middle", () => {
    const bar = rangeBar(joint({ lowest: 1500, highest: 1500 }));
    expect(bar.swept).toEqual({ begin: 0.5, width: 0 });
    expect(bar.present).toBe(0.5);
  });
  it("has no expectation where no width is known", () => {
    expect(rangeBar(joint({ expected_width: 0 })).expected).toBeNull();
  });
});

it("tells ranges and droop in degrees", () => {
  expect(rangeText(joint({ lowest: 0, highest: 1024, expected_width: 2048 }))).toBe("90° of about 180°");
  expect(rangeText(joint({ lowest: 0, highest: 1024, expected_width: 0 }))).toBe("90°");
  expect(droopText(Math.PI / 180)).toBe("droop 1.0°");
  expect(droopText(Number.NaN)).toBe("");
});

it("asks another question when step or answers change, and not when the arm moves on or figures of the instruction change", () => {
  const question = questionOf(state());
  expect(questionOf(state({ progress: 0.9, joints: [] }))).toBe(question);
  expect(questionOf(state({ instruction: "Move it by 12°." }))).toBe(question);
  expect(questionOf(state({ step: "next" }))).not.toBe(question);
  expect(questionOf(state({ answers: ["yes", "no"] }))).not.toBe(question);
});

describe("HandObserver", () => {
  const at = (position_rad: number): Joints => ({ ...emptyState("").joints, names: ["elbow", "wrist"], position_rad: [position_rad, 0] });
  const moved = (present: number, wrist = 2000): Commissioning => {
    return state({ joints: [joint({ present }), joint({ joint: "wrist", present: wrist })] });
  };

  it("takes the joint that moves most for the one in hand, and keeps it while all rest", () => {
    const hand = new HandObserver();
    expect(hand.observe(moved(1500), at(0))).toBeNull();
    expect(hand.observe(moved(1501, 2030), at(0))?.joint).toBe("wrist");
    expect(hand.observe(moved(1502, 2031), at(0))?.joint).toBe("wrist");
    expect(hand.observe(moved(1600, 2032), at(0))?.joint).toBe("elbow");
  });

  it("notices a joint that moves slowly", () => {
    const hand = new HandObserver();
    const seen = [0, 3, 6, 9, 12].map((ticks) => hand.observe(moved(1500 + ticks), at(0))?.joint);
    expect(seen.at(-1)).toBe("elbow");
  });

  it.each([1, -1] as const)("learns the sign %i of a joint from ticks and angles", (sign) => {
    const hand = new HandObserver();
    const seen = [0, 100, 200, 300].map((ticks) => {
      return hand.observe(moved(1500 + ticks), at(sign * ticksToRadians(ticks)))?.direction;
    });
    expect(seen.at(-1)).toBe(sign);
  });

  it("does not learn from an angle that does not follow the ticks", () => {
    const hand = new HandObserver();
    for (const ticks of [0, 300, 600]) hand.observe(moved(1500 + ticks), at(-0.001));
    expect(hand.observe(moved(2400), at(-0.001))?.direction).toBe(1);
  });

  it("forgets everything when the procedure ends, as a calibration may turn a joint's sign", () => {
    const hand = new HandObserver();
    for (const ticks of [0, 300]) hand.observe(moved(1500 + ticks), at(-ticksToRadians(ticks)));
    expect(hand.observe(state({ procedure: "" }), at(0))).toBeNull();
    expect(hand.observe(moved(1500), at(0))).toBeNull();
    expect(hand.observe(moved(1600), at(0))).toEqual({ joint: "elbow", direction: 1 });
  });
});
