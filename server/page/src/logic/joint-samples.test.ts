import { describe, expect, it, test } from "vitest";
import { emptyState, type State } from "../state/state";
import { csv, curveUnit, JointSamples, type Column } from "./joint-samples";

function stateAt(stamp: number, position_rad: number[], names = ["a", "b"]): State {
  const joints = { names, position_rad, velocity: [0.5, Number.NaN], effort: [0.25, -0.1], stamp };
  const servo = { name: "a", hardware: "servo 1", level: 0, message: "", values: { temperature_c: "31" } };
  return { ...emptyState("ws://x"), joints, commanded_rad: { a: 1 }, servos: [servo] };
}

function columnsOf(...pairs: [string, Column["quantity"]][]): Column[] {
  return pairs.map(([joint, quantity]) => ({ joint, quantity, unit: curveUnit(stateAt(0, []), joint, quantity) }));
}

describe("samples", () => {
  it("have every quantity, and no number where the server has none", () => {
    const samples = new JointSamples();
    samples.record(stateAt(1, [0.75, 2]));
    const values = (joint: string): unknown[] => {
      const first = samples.curve(joint, "position");
      return samples.series.span(0, 2, [0, 1, 2, 3, 4, 5].map((index) => first + index)).slice(1).flat();
    };
    expect(values("a")).toEqual([0.75, 1, 0.25, 0.5, 0.25, 31]);
    expect(values("b")).toEqual([2, null, null, null, -0.1, null]);
  });

  it("begin anew for another arm, and after a step back in time", () => {
    const samples = new JointSamples();
    samples.record(stateAt(10, [0, 0]));
    samples.record(stateAt(3, [0, 0]));
    expect(samples.series.times_s[0]).toBe(3);
    samples.record(stateAt(4, [0, 0], ["c", "d"]));
    expect([samples.series.times_s[0], samples.curve("a", "load")]).toEqual([4, -1]);
  });

  it("take a bounded space for any number of joints", () => {
    const samples = new JointSamples();
    const names = Array.from({ length: 100 }, (_, index) => `joint_${index}`);
    samples.record(stateAt(1, names.map(() => 0), names));
    expect(samples.series.capacity * (samples.series.curves + 1)).toBeLessThanOrEqual(2_000_000);
  });
});

test("a file has a column for each joint and quantity with its unit, and times in seconds", () => {
  const samples = new JointSamples();
  for (const stamp of [1000, 1000.5, 1001, 1001.5]) samples.record(stateAt(stamp, [Math.PI / 2, 0]));
  const text = csv(samples, columnsOf(["a", "position"], ["a", "load"], ["b", "goal"], ["a", "velocity"]), 1000.5, 1001);
  expect(text.split("\r\n")).toEqual([
    "time [s],a position [°],a load [%],b goal [°],a velocity [°/s]",
    "0.0000,90,25,,28.64789",
    "0.5000,90,25,,28.64789",
    "",
  ]);
});

test("a name with a comma is quoted", () => {
  expect(csv(new JointSamples(), columnsOf(["a,b", "load"]), 0, 1)).toBe('time [s],"a,b load [%]"\r\n');
});
