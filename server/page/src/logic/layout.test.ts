import { describe, expect, it, test } from "vitest";
import { closePanel, columnOf, movePanel, openPanel, parseLayout, type Layout } from "./layout";

const LAYOUT: Layout = { panels: { first: ["a", "b", "c"], second: [] }, shown: { first: "b", second: "" } };

test("a closed panel is opened in the first column and shown", () => {
  expect(openPanel(LAYOUT, "d")).toEqual({ panels: { first: ["a", "b", "c", "d"], second: [] }, shown: { first: "d", second: "" } });
});

test("an open panel is shown where it is", () => {
  const moved = movePanel(LAYOUT, "c");
  expect(openPanel({ ...moved, shown: { first: "a", second: "" } }, "c").shown).toEqual({ first: "a", second: "c" });
});

test("a panel that is closed gives way to the one before it", () => {
  expect(closePanel(LAYOUT, "b").shown.first).toBe("a");
  expect(closePanel(LAYOUT, "c").shown.first).toBe("b");
  expect(closePanel({ ...LAYOUT, panels: { first: ["b"], second: [] } }, "b").shown.first).toBe("");
});

test("a panel goes to the other column and back", () => {
  const moved = movePanel(LAYOUT, "b");
  expect(columnOf(moved, "b")).toBe("second");
  expect(moved.shown).toEqual({ first: "a", second: "b" });
  expect(movePanel(moved, "b").panels).toEqual({ first: ["a", "c", "b"], second: [] });
});

describe("parseLayout", () => {
  it("gives back what was stored", () => {
    expect(parseLayout(JSON.stringify(LAYOUT), ["a", "b", "c"], LAYOUT)).toEqual(LAYOUT);
  });
  it("leaves out panels that do not exist, and shows another", () => {
    expect(parseLayout(JSON.stringify(LAYOUT), ["c", "d"], LAYOUT)).toEqual({
      panels: { first: ["c"], second: [] },
      shown: { first: "c", second: "" },
    });
  });
  it("has each panel once", () => {
    const twice = { panels: { first: ["a", "a"], second: ["a", "b"] }, shown: { first: "a", second: "a" } };
    expect(parseLayout(JSON.stringify(twice), ["a", "b"], LAYOUT).panels).toEqual({ first: ["a"], second: ["b"] });
  });
  it.each(["", "x", "{}", "null", '{"panels":{"first":1}}'])("takes the initial layout for %s", (text) => {
    expect(parseLayout(text, ["a"], LAYOUT)).toBe(LAYOUT);
  });
});
