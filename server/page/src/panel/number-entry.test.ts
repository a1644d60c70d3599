import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { NumberEntry } from "./number-entry";

/** Part of an element that a number field uses. */
class FakeElement extends EventTarget {
  value = "";
}

const fake_document = { activeElement: null as unknown };
const RANGE = { name: "x", lower: -1, upper: 1, unit: " m", digits: 4 };

let taken: number[];
let input: HTMLInputElement;
let field: NumberEntry;

beforeEach(() => {
  vi.stubGlobal("document", fake_document);
  fake_document.activeElement = null;
  taken = [];
  input = new FakeElement() as unknown as HTMLInputElement;
  field = new NumberEntry(input, () => ({ range: RANGE, take: (value) => taken.push(value), report: () => undefined }));
  field.show("0.1000");
});
afterEach(() => vi.unstubAllGlobals());

function focus(): void {
  fake_document.activeElement = input;
}

function type(text: string): void {
  input.value = text;
  input.dispatchEvent(new Event("input"));
}

function pressEnter(): void {
  input.dispatchEvent(Object.assign(new Event("keydown"), { key: "Enter" }));
}

function leave(): void {
  fake_document.activeElement = null;
  input.dispatchEvent(new Event("change"));
  input.dispatchEvent(new Event("blur"));
}

test("a field that the user is about to type in keeps its text, and with it the selection", () => {
  focus();
  field.show("0.2000");
  expect(input.value).toBe("0.1000");
});

test("a field that is left without typing shows the newest value", () => {
  focus();
  field.show("0.2000");
  leave();
  expect(input.value).toBe("0.2000");
  expect(taken).toEqual([]);
});

test("a typed number is taken, whatever came between the text and Enter", () => {
  focus();
  type("0.25");
  field.show("0.2000");
  pressEnter();
  expect(taken).toEqual([0.25]);
  expect(input.value).toBe("0.25");
});

test("a number that is entered and then left is taken once", () => {
  focus();
  type("0.25");
  pressEnter();
  leave();
  expect(taken).toEqual([0.25]);
  expect(input.value).toBe("0.25");
});

test("the same number typed again is taken again", () => {
  focus();
  type("0.25");
  pressEnter();
  field.show("0.2000");
  type("0.25");
  pressEnter();
  expect(taken).toEqual([0.25, 0.25]);
});

test("an invalid text is reverted to the newest value", () => {
  focus();
  type("abc");
  field.show("0.2000");
  pressEnter();
  expect(input.value).toBe("0.2000");
  expect(taken).toEqual([]);
});
