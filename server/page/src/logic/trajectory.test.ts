import { describe, expect, it } from "vitest";
import { emptyState, NO_PLAN, type State } from "../state/state";
import { duration_s, ghostPose, samplePlan, sampleTimes_s } from "./trajectory";

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

const SHORT_PLAN = { names: ["pan"], points: [{ time_s: 0, position_rad: [0] }, { time_s: 1, position_rad: [1] }] };

function state(patch: Partial<State>): State {
  return { ...emptyState("ws://h"), ...patch };
}

describe("ghostPose", () => {
  it("is absent when nothing is asked for", () => {
    expect(ghostPose(state({}))).toBeNull();
  });
  it("shows the end of a plan, or where the scrubber stands", () => {
    const plan = { ...NO_PLAN, trajectory: SHORT_PLAN };
    expect(ghostPose(state({ plan }))?.joints_rad).toEqual({ pan: 1 });
    expect(ghostPose(state({ plan: { ...plan, scrub_s: 0.25 } }))?.joints_rad).toEqual({ pan: 0.25 });
  });
  it("shows wished joints", () => {
    expect(ghostPose(state({ selection: { kind: "named", joints_rad: { pan: 2 } } }))?.joints_rad).toEqual({ pan: 2 });
  });
  it("tells how far the target is when it is off", () => {
    const target = { position_m: null, orientation: null, dragging: true, reachable: false, distance_m: 0.12, joints_rad: { pan: 3 } };
    const selection = { kind: "target" as const, joints_rad: null };
    expect(ghostPose(state({ target, selection }))).toEqual({ joints_rad: { pan: 3 }, off_target_m: 0.12 });
    expect(ghostPose(state({ target: { ...target, reachable: true }, selection }))?.off_target_m).toBeNull();
    expect(ghostPose(state({ target: { ...target, joints_rad: null }, selection }))).toBeNull();
  });
});
