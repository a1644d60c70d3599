import { describe, expect, it, test } from "vitest";
import { distanceText, inUnits, parseNumber, positionText, unitOf } from "./numbers";

const DEG = unitOf("revolute", "deg");
const RAD = unitOf("continuous", "rad");
const MM = unitOf("prismatic", "deg");
const M = unitOf("prismatic", "rad");

test("there and back is the same angle", () => {
});

test("texts have the digits that matter, no minus before nought, and a dash for what is no number", () => {
  expect(positionText(Math.PI / 2, DEG)).toBe("90.0");
  expect(positionText(0.12345, RAD)).toBe("0.123");
  expect(positionText(-0.0001, DEG)).toBe("0.0");
  expect(positionText(Number.NaN, DEG)).toBe("–");
});

test("a joint that slides is shown in millimetres beside degrees, and in metres beside radians", () => {
  expect([positionText(0.1234, MM), MM.suffix]).toEqual(["123.4", " mm"]);
  expect([positionText(0.12345, M), M.suffix]).toEqual(["0.1235", " m"]);
});

describe("distanceText", () => {
  it("is in the chosen unit, to the millimetre", () => {
    expect([0.0034, 0.1234].map((distance_m) => distanceText(distance_m, "deg"))).toEqual(["3 mm", "123 mm"]);
    expect([0.0034, 0.1234].map((distance_m) => distanceText(distance_m, "rad"))).toEqual(["0.003 m", "0.123 m"]);
  });
  it("is never 0", () => {
    expect([distanceText(0.0001, "deg"), distanceText(0.0001, "rad")]).toEqual(["1 mm", "0.001 m"]);
  });
});

const range = { name: "elbow_flex", lower: -90, upper: 90, unit: "°", digits: 1 };

test("a number within the limits is taken, with a comma too", () => {
  expect(parseNumber(" 12,5 ", range)).toEqual({ value: 12.5, message: "" });
  expect(parseNumber("-90", range)).toEqual({ value: -90, message: "" });
  expect(parseNumber("1e1", range)).toEqual({ value: 10, message: "" });
});

test("beyond a limit it goes to the limit, and the range is named", () => {
  expect(parseNumber("120", range)).toEqual({
    value: 90,
    message: "elbow_flex: 120° is outside of -90° to 90°",
  });
  expect(parseNumber("-100.04", range).message).toBe("elbow_flex: -100° is outside of -90° to 90°");
});

test.each(["", "abc", "NaN", "Infinity", "1e999", "0x10", "--3"])("%j is no number: what was there comes back", (text) => {
  const typed = parseNumber(text, range);
  expect(typed.value).toBeNull();
  expect(typed.message).toContain("is no number");
});

test.each([
  ["cannot reach (0.9, 0, 0.3) m: 54.0 cm away", "cannot reach (900, 0, 300) mm: 540 mm away", "cannot reach (0.9, 0, 0.3) m: 0.54 m away"],
  ["goes to 1.92 rad, outside -1.5708 to 1.5708 rad", "goes to 110°, outside -90 to 90°", "goes to 1.92 rad, outside -1.571 to 1.571 rad"],
  ["turns at 3.10 rad/s, 2 s after servo 3 met link_1 m", "turns at 3.10 rad/s, 2 s after servo 3 met link_1 m", "turns at 3.10 rad/s, 2 s after servo 3 met link_1 m"],
  ["link_1 at joint_1 -1.571, wrist_2 0, a3 0.500 rad", "link_1 at joint_1 -90, wrist_2 0, a3 28.6°", "link_1 at joint_1 -1.571, wrist_2 0, a3 0.5 rad"],
  ["in contact by 1e-3 m", "in contact by 1 mm", "in contact by 0.001 m"],
])("%s in the chosen units", (sentence, degrees, radians) => {
  expect(inUnits(sentence, "deg")).toBe(degrees);
  expect(inUnits(sentence, "rad")).toBe(radians);
});
