import { expect, test } from "vitest";
import type { ServoState } from "../state/state";
import { complaints, servoReport } from "./servo-report";

const servo = (values: Record<string, string>): ServoState => ({ name: "gripper", hardware: "servo 6", level: 0, message: "", values });

test("registers are read by name, those that differ first", () => {
  const { registers } = servoReport(servo({ torque: "on", "register/ID": "6", "register/P": "16", "expected/P": "32" }));
  expect(registers).toEqual([
    { name: "P", value: "16", expected: "32", differs: true },
    { name: "ID", value: "6", expected: "", differs: false },
  ]);
});

test("a register that a warning names differs too, and not one that has a part of its name", () => {
  const warned = { ...servo({ "register/GAIN": "1", "register/P_GAIN": "20" }), level: 1, message: "register P_GAIN is 20, not 32" };
  expect(servoReport(warned).registers.map(({ name, differs }) => [name, differs])).toEqual([
    ["P_GAIN", true],
    ["GAIN", false],
  ]);
});

test("what differs is told in plain sentences, where the server does not tell it itself", () => {
  const values = { "register/P": "16", "expected/P": "32", "register/ID": "6", advice: "warm: let it cool." };
  expect(complaints(servo(values))).toEqual(["P is 16, where 32 is expected.", "warm: let it cool."]);
  expect(complaints({ ...servo(values), level: 1, message: "P is odd; it is warm" })).toEqual([
    "P is odd",
    "it is warm",
    "warm: let it cool.",
  ]);
});

test("a servo that is well has nothing to tell", () => {
  expect(complaints({ ...servo({ "register/P": "16" }), level: 0, message: "no complaints" })).toEqual([]);
});

test("errors are told by kind, the most frequent first, without those that did not happen", () => {
  const { errors } = servoReport(servo({ "error/timeout": "2", "error/overload": "7", "error/checksum": "0", "error/odd": "x" }));
  expect(errors).toEqual([
    { kind: "overload", count: 7 },
    { kind: "timeout", count: 2 },
  ]);
});

test("advice has a sentence a line", () => {
  expect(servoReport(servo({ advice: "It is hot.\n\nLet it cool.\n" })).advice).toEqual(["It is hot.", "Let it cool."]);
  expect(servoReport(servo({})).advice).toEqual([]);
});
