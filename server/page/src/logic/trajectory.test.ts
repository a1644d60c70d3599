import { describe, expect, it } from "vitest";
import { duration_s, samplePlan, sampleTimes_s } from "./trajectory";

const PLAN = {
  names: ["pan", "lift"],
  points: [
    { time_s: 0, position_rad: [0, 1] },
    { time_s: 2, position_rad: [1, 0] },
    { time_s: 3, position_rad: [1, -1] },
  ],
};

describe("samplePlan", () => {
  it("goes straight between two points", () => {
    expect(samplePlan(PLAN, 1)).toEqual({ pan: 0.5, lift: 0.5 });
    expect(samplePlan(PLAN, 2.5)).toEqual({ pan: 1, lift: -0.5 });
  });
  it("holds the ends", () => {
    expect(samplePlan(PLAN, -1)).toEqual({ pan: 0, lift: 1 });
    expect(samplePlan(PLAN, 99)).toEqual({ pan: 1, lift: -1 });
  });
  it("gives nothing for a plan without points", () => {
    expect(samplePlan({ names: ["pan"], points: [] }, 0)).toEqual({});
  });
  it("takes the later of two points at one time", () => {
    const plan = { names: ["pan"], points: [{ time_s: 0, position_rad: [3] }] };
    expect(samplePlan(plan, 0)).toEqual({ pan: 3 });
  });
});

describe("times", () => {
  it("span the plan", () => {
    expect(duration_s(PLAN)).toBe(3);
    expect(sampleTimes_s(PLAN, 4)).toEqual([0, 1, 2, 3]);
    expect(duration_s({ names: [], points: [] })).toBe(0);
  });
});
