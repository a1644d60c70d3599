import { parseNumber, type NumberRange } from "../logic/numbers";

/** Limits of a number field, and the receiver of its values. */
export interface NumberTaker {
  range: NumberRange;
  take: (value: number) => void;
  /** Show the problem of the typed text; empty for none. */
  report: (problem: string) => void;
}

/** Entry of a number in an input: clamped to its limits, reverted when it is invalid, with a message for either. */
export class NumberEntry {
  private newest = "";
  // Enter and, after it, the browser's change come for one text.
  private edited = false;

  /** @param taker - returns the present limits and receiver. */
  constructor(
    private readonly input: HTMLInputElement,
    private readonly taker: () => NumberTaker,
  ) {
    input.addEventListener("input", () => {
      this.edited = true;
      taker().report("");
    });
    input.addEventListener("change", () => this.commit());
    input.addEventListener("blur", () => this.write());
    input.addEventListener("keydown", (event) => event.key === "Enter" && this.commit());
  }

  /** Show a value; while the field has the focus it keeps its text, and shows the newest value when it is left. */
  show(text: string): void {
    this.newest = text;
    // A new text would end the user's selection, and what is typed next would be added to it.
    if (document.activeElement !== this.input) this.write();
  }

  private write(): void {
    if (this.input.value !== this.newest) this.input.value = this.newest;
  }

  private commit(): void {
    if (!this.edited) return;
    this.edited = false;
    const { range, take, report } = this.taker();
    const { value, message } = parseNumber(this.input.value, range);
    report(message);
    if (value !== null) this.newest = String(Number(value.toFixed(range.digits)));
    this.write();
    if (value !== null) take(value);
  }
}
