import { describe, expect, it, test } from "vitest";
import { DeadMan, gamepadCommands, isDeadManHeld, jointKeys, keyCommand, LEFT_PAD, padCommand, PAD_REACH_PX, printedKey, rightPad, scaled, shaped, summed, tipAxes, type JogCommand } from "./jog";

test.each([
  [3, ["x", "y", "z"]],
  [4, ["x", "y", "z", "pitch"]],
  [5, ["x", "y", "z", "roll", "pitch"]],
  [6, ["x", "y", "z", "roll", "pitch", "yaw"]],
  [7, ["x", "y", "z", "roll", "pitch", "yaw"]],
])("an arm of %i joints has the axes %s", (joints, axes) => expect(tipAxes(joints)).toEqual(axes));

test("inputs add up within the limits, and opposite ones cancel out", () => {
  const tip = (velocity: object): JogCommand => ({ kind: "tip", velocity });
  expect(summed([tip({ x: 0.7, y: 1 }), tip({ x: 0.7, y: -1 })])).toEqual({ x: 1 });
  expect(scaled(tip({ x: -1 }), 0.5)).toEqual(tip({ x: -0.5 }));
});

describe("a stick", () => {
  it("has a dead zone and reaches full speed", () => {
    expect([shaped(0.14, 0.15), shaped(-0.15, 0.15), shaped(1, 0.15), shaped(-1.2, 0.15)]).toEqual([0, 0, 1, -1]);
    expect(shaped(Number.NaN, 0.15)).toBe(0);
  });
  it("is finer around its middle", () => expect(shaped(0.5, 0)).toBeCloseTo(0.3125));
});

describe("keys", () => {
  const axes = tipAxes(5);
  it.each([
    ["ArrowUp", "tip", { x: 1 }],
    ["ArrowRight", "tip", { y: -1 }],
    ["KeyC", "tip", { pitch: -1 }],
    ["Digit2", "joints", { b: 1 }],
    ["KeyQ", "joints", { a: -1 }],
    ["KeyB", "gripper", { opening: -1 }],
  ])("%s moves the %s", (code, kind, velocity) => expect(keyCommand(code, axes, ["a", "b"])).toEqual({ kind, velocity }));
  it.each([["KeyF"], ["Digit3"], ["Tab"]])("%s moves nothing that there is not", (code) => {
    expect(keyCommand(code, axes, ["a", "b"])).toBeNull();
  });
  it("has keys for twelve joints", () => {
    expect(jointKeys(11)?.map(printedKey)).toEqual(["=", "]"]);
    expect(jointKeys(12)).toBeNull();
    expect(printedKey("ArrowUp")).toBe("↑");
  });
});

describe("a gamepad", () => {
  const pad = (axes: number[], pressed: Record<number, number>): Parameters<typeof gamepadCommands>[0] => ({
    axes,
    buttons: Array.from({ length: 17 }, (_, index) => ({ pressed: (pressed[index] ?? 0) > 0.5, value: pressed[index] ?? 0 })),
  });
  it("moves nothing without the dead-man", () => {
    expect(gamepadCommands(pad([1, 1, 1, 1], { 7: 1, 0: 1 }), tipAxes(6))).toEqual([]);
    expect(isDeadManHeld(pad([], { 5: 1 }))).toBe(true);
  });
  it("moves the tip away, to the left, up, and turns it", () => {
    const read = gamepadCommands(pad([-1, -1, 1, -1], { 4: 1, 7: 1, 14: 1 }), tipAxes(6));
    expect(read).toEqual([{ kind: "tip", velocity: { x: 1, y: 1, z: 1, roll: 1, pitch: 1, yaw: 1 } }]);
  });
  it("has no axes that the arm has not, and rests within the dead zone", () => {
    expect(gamepadCommands(pad([0.1, 0, 1, 0], { 5: 1 }), tipAxes(3))).toEqual([]);
  });
  it("opens and closes the gripper", () => {
    expect(gamepadCommands(pad([], { 4: 1, 0: 1 }), [])).toEqual([{ kind: "gripper", velocity: { opening: -1 } }]);
  });
  it("counts after a stop only when the dead-man was released once", () => {
    const dead_man = new DeadMan();
    expect([true, false, true].map((held) => dead_man.counts(held))).toEqual([false, false, true]);
    dead_man.lock();
    expect([true, true, false, true].map((held) => dead_man.counts(held))).toEqual([false, false, false, true]);
  });
});

describe("a pad", () => {
  it("moves the tip where the thumb goes", () => {
    expect(padCommand(LEFT_PAD, 0, -PAD_REACH_PX).velocity).toEqual({ x: 1 });
    expect(padCommand(LEFT_PAD, 2 * PAD_REACH_PX, 0).velocity).toEqual({ y: -1 });
    expect(padCommand(rightPad("roll"), PAD_REACH_PX, PAD_REACH_PX).velocity).toEqual({ roll: 1, z: -1 });
  });
  it("rests under a resting thumb, and without a rotation", () => {
    expect(padCommand(LEFT_PAD, 4, -5).velocity).toEqual({});
    expect(padCommand(rightPad(null), PAD_REACH_PX, 0).velocity).toEqual({});
  });
});
