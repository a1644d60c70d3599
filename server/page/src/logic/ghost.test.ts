import { describe, expect, it } from "vitest";
import { emptyState, type State } from "../state/state";
import { distanceText, ghostPose } from "./ghost";

const PLAN = { names: ["pan"], points: [{ time_s: 0, position_rad: [0] }, { time_s: 1, position_rad: [1] }] };

function state(patch: Partial<State>): State {
  return { ...emptyState("ws://h"), ...patch };
}

describe("ghostPose", () => {
  it("is absent when nothing is asked for", () => {
    expect(ghostPose(state({}))).toBeNull();
  });
  it("shows the end of a plan, or where the scrubber stands", () => {
    const plan = { trajectory: PLAN, tool_path: [], scrub_s: null };
    expect(ghostPose(state({ plan }))?.joints_rad).toEqual({ pan: 1 });
    expect(ghostPose(state({ plan: { ...plan, scrub_s: 0.25 } }))?.joints_rad).toEqual({ pan: 0.25 });
  });
  it("shows wished joints", () => {
    expect(ghostPose(state({ wish: { kind: "named", joints_rad: { pan: 2 } } }))?.joints_rad).toEqual({ pan: 2 });
  });
  it("tells how far the target is when it is off", () => {
    const target = { position_m: null, dragging: true, reachable: false, distance_m: 0.12, joints_rad: { pan: 3 } };
    const wish = { kind: "target" as const, joints_rad: null };
    expect(ghostPose(state({ target, wish }))).toEqual({ joints_rad: { pan: 3 }, off_target_m: 0.12 });
    expect(ghostPose(state({ target: { ...target, reachable: true }, wish }))?.off_target_m).toBeNull();
    expect(ghostPose(state({ target: { ...target, joints_rad: null }, wish }))).toBeNull();
  });
});

describe("distanceText", () => {
  it("takes millimetres below a centimetre", () => {
    expect(distanceText(0.0034)).toBe("3 mm");
    expect(distanceText(0.0001)).toBe("1 mm");
    expect(distanceText(0.1234)).toBe("12.3 cm");
  });
});
