import { readNumber, type Range } from "../logic/typed";
import { el, write } from "./dom";

/** A box for a number, with a place for what is wrong with it. */
export interface NumberField {
  input: HTMLInputElement;
  problem: HTMLElement;
  /** Show a value, unless somebody is typing. */
  show: (text: string) => void;
}

/**
 * A box for a typed number: clamped at its limits, reverted when it is none, and both are told.
 *
 * @param testid - names the box; its message is `<testid>-problem`.
 * @param range - gives the limits of the moment.
 * @param take - called with a number that was typed.
 */
export function numberField(testid: string, label: string, range: () => Range, take: (value: number) => void): NumberField {
  const problem = el("small", { class: "problem", testid: `${testid}-problem`, role: "alert" });
  const attributes = { inputmode: "decimal", autocomplete: "off", spellcheck: "false" };
  const input = el("input", { type: "text", class: "number", testid, label, attributes });
  let shown = "";
  const commit = (): void => {
    // Enter is followed by the field's own change, with the number that was put there.
    if (input.value === shown) return;
    const { value, message } = readNumber(input.value, range());
    write(problem, message);
    input.value = value === null ? shown : String(Number(value.toFixed(range().digits)));
    shown = input.value;
    if (value !== null) take(value);
  };
  input.addEventListener("input", () => write(problem, ""));
  input.addEventListener("change", commit);
  input.addEventListener("keydown", (event) => event.key === "Enter" && commit());
  const show = (text: string): void => {
    if (document.activeElement !== input || input.value === shown) {
      if (input.value !== text) input.value = text;
      shown = text;
    }
  };
  return { input, problem, show };
}
