import { expect, test } from "vitest";
import { isJogKey, jogVelocities, keyNames } from "./jog";

test("held keys turn their joints, and both keys of a joint hold it", () => {
  const held = new Set(["Digit1", "KeyW", "Digit3", "KeyE"]);
  expect(jogVelocities(held, ["a", "b", "c"], 0.5)).toEqual({ a: 0.5, b: -0.5 });
  expect(jogVelocities(new Set(), ["a"], 1)).toEqual({});
});

test("only the keys of joints that there are count", () => {
  expect(isJogKey("Digit2", 2)).toBe(true);
  expect(isJogKey("KeyE", 2)).toBe(false);
  expect(keyNames(0)).toBe("1 / Q");
  expect(keyNames(11)).toBe("= / ]");
  expect(isJogKey("BracketRight", 12)).toBe(true);
  expect(keyNames(12)).toBe("– / –");
});
