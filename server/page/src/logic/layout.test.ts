import { expect, test } from "vitest";
import { closePanel, openPanel, parseLayout, pinPanel, type Layout } from "./layout";

const LAYOUT: Layout = { shown: "a", pinned: "b" };

test("a panel takes the place of the shown one, and a pinned one stays where it is", () => {
  expect(openPanel(LAYOUT, "c")).toEqual({ shown: "c", pinned: "b" });
  expect(openPanel(LAYOUT, "b")).toBe(LAYOUT);
});

test("a closed panel leaves the other one", () => {
  expect(closePanel(LAYOUT, "a")).toEqual({ shown: "", pinned: "b" });
  expect(closePanel(LAYOUT, "b")).toEqual({ shown: "a", pinned: "" });
});

test("a pinned panel changes places with the one before it", () => {
  expect(pinPanel({ shown: "a", pinned: "" })).toEqual({ shown: "", pinned: "a" });
  expect(pinPanel(LAYOUT)).toEqual({ shown: "b", pinned: "a" });
});

test("a stored layout comes back with the panels that exist, each once", () => {
  expect(parseLayout(JSON.stringify(LAYOUT), ["a", "b"], LAYOUT)).toEqual(LAYOUT);
  expect(parseLayout(JSON.stringify(LAYOUT), ["b"], LAYOUT)).toEqual({ shown: "", pinned: "b" });
  expect(parseLayout('{"shown":"a","pinned":"a"}', ["a"], LAYOUT)).toEqual({ shown: "a", pinned: "" });
});

test.each(["", "x", "{}", "null", '{"shown":1}'])("the initial layout is taken for %s", (text) => {
  expect(parseLayout(text, ["a"], LAYOUT)).toBe(LAYOUT);
});
