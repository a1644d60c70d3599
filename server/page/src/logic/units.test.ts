import { expect, test } from "vitest";
import { angleText, fromUnit, toUnit } from "./units";

test("there and back is the same angle", () => {
  expect(fromUnit(toUnit(1.234, "deg"), "deg")).toBeCloseTo(1.234, 12);
  expect(toUnit(Math.PI, "deg")).toBeCloseTo(180, 12);
  expect(toUnit(1.5, "rad")).toBe(1.5);
});

test("texts have the digits that matter, no minus before nought, and a dash for what is no number", () => {
  expect(angleText(Math.PI / 2, "deg")).toBe("90.0");
  expect(angleText(0.12345, "rad")).toBe("0.123");
  expect(angleText(-0.0001, "deg")).toBe("0.0");
  expect(angleText(Number.NaN, "deg")).toBe("–");
});
