import { describe, expect, it } from "vitest";
import { jointReport, looksSame, unknownNamesText, withoutNumberText } from "./joint-report";

const KNOWN = new Set(["pan", "lift"]);

function joints(names: string[], position_rad: number[]) {
  return { names, position_rad, velocity: [], effort: [], stamp: 0 };
}

describe("jointReport", () => {
  it("takes finite positions of known joints", () => {
    const report = jointReport(joints(["lift", "pan"], [0.5, -1]), KNOWN);
    expect(report).toEqual({ values: { lift: 0.5, pan: -1 }, unknown: [], without_number: [] });
    expect(unknownNamesText(report, KNOWN)).toBe("");
    expect(withoutNumberText(report)).toBe("");
  });
  it("leaves out what is no number, and says so", () => {
    const report = jointReport(joints(["pan", "lift"], [Number.NaN]), KNOWN);
    expect(report.values).toEqual({});
    expect(withoutNumberText(report)).toContain("pan, lift");
    expect(jointReport(joints(["pan"], [Infinity]), KNOWN).without_number).toEqual(["pan"]);
  });
  it("names what the robot does not have", () => {
    const report = jointReport(joints(["elbow"], [1]), KNOWN);
    expect(unknownNamesText(report, KNOWN)).toContain("elbow");
    expect(unknownNamesText(report, KNOWN)).toContain("pan, lift");
  });
});

describe("looksSame", () => {
  const pan = joints(["pan", "lift"], [0.5, -1]);
  it("overlooks what cannot be seen", () => {
    expect(looksSame(pan, joints(["pan", "lift"], [0.50001, -1]))).toBe(true);
    expect(looksSame(joints(["pan"], [Number.NaN]), joints(["pan"], [Number.NaN]))).toBe(true);
  });
  it.each([
    ["a motion", joints(["pan", "lift"], [0.502, -1])],
    ["other names", joints(["pan", "roll"], [0.5, -1])],
    ["fewer joints", joints(["pan"], [0.5])],
    ["a number that is none", joints(["pan", "lift"], [Number.NaN, -1])],
  ])("sees %s", (_, other) => {
    expect(looksSame(pan, other)).toBe(false);
    expect(looksSame(other, pan)).toBe(false);
  });
});
