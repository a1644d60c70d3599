import { expect, test } from "vitest";
import { readNumber } from "./typed";

const range = { name: "elbow_flex", lower: -90, upper: 90, unit: "°", digits: 1 };

test("a number within the limits is taken, with a comma too", () => {
  expect(readNumber(" 12,5 ", range)).toEqual({ value: 12.5, message: "" });
  expect(readNumber("-90", range)).toEqual({ value: -90, message: "" });
  expect(readNumber("1e1", range)).toEqual({ value: 10, message: "" });
});

test("beyond a limit it goes to the limit, and the limit is named", () => {
  expect(readNumber("120", range)).toEqual({
    value: 90,
    message: "elbow_flex: 120° is beyond the upper limit, 90°",
  });
  expect(readNumber("-100.04", range).message).toBe("elbow_flex: -100° is beyond the lower limit, -90°");
});

test.each(["", "abc", "NaN", "Infinity", "1e999", "0x10", "--3"])("%j is no number: what was there comes back", (text) => {
  const typed = readNumber(text, range);
  expect(typed.value).toBeNull();
  expect(typed.message).toContain("is no number");
});
