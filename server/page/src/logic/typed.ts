/** What becomes of a number that somebody typed. */
export interface Typed {
  /** The number to take; null reverts to what was there before. */
  value: number | null;
  /** Why it is another than was typed; empty when it is not. */
  message: string;
}

/** A range with words for it. */
export interface Range {
  name: string;
  lower: number;
  upper: number;
  /** Written behind the numbers. */
  unit: string;
  digits: number;
}

/** Read a typed number: what is none is reverted, what is outside goes to the limit, and both are told. */
export function readNumber(text: string, range: Range): Typed {
  const typed = text.trim().replace(",", ".").replace("−", "-");
  const value = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,3})?$/i.test(typed) ? Number(typed) : Number.NaN;
  if (!Number.isFinite(value)) {
    return { value: null, message: `${range.name}: “${shortened(text)}” is no number` };
  }
  if (value < range.lower) return atLimit(value, range.lower, "lower", range);
  if (value > range.upper) return atLimit(value, range.upper, "upper", range);
  return { value, message: "" };
}

function atLimit(value: number, limit: number, which: string, range: Range): Typed {
  const written = (number: number): string => `${Number(number.toFixed(range.digits))}${range.unit}`;
  const message = `${range.name}: ${written(value)} is beyond the ${which} limit, ${written(limit)}`;
  return { value: limit, message };
}

function shortened(text: string): string {
  return text.length > 20 ? `${text.slice(0, 20)}…` : text;
}

/** A value within a range. */
export function clamp(value: number, lower: number, upper: number): number {
  return Math.min(upper, Math.max(lower, value));
}
