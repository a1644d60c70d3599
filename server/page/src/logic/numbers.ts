const DEGREES_PER_RADIAN = 180 / Math.PI;

/** Unit of displayed and typed angles. */
export type AngleUnit = "deg" | "rad";

/** Convert an angle from radians. */
export function toUnit(value_rad: number, unit: AngleUnit): number {
  return unit === "deg" ? value_rad * DEGREES_PER_RADIAN : value_rad;
}

/** Convert an angle to radians. */
export function fromUnit(value: number, unit: AngleUnit): number {
  return unit === "deg" ? value / DEGREES_PER_RADIAN : value;
}

/** Decimals of displayed angles, from the servo's resolution of 0.0015 rad. */
const DIGITS: Record<AngleUnit, number> = { deg: 1, rad: 3 };

/** Format an angle without its unit; a dash where it is not finite. */
export function angleText(value_rad: number, unit: AngleUnit): string {
  return Number.isFinite(value_rad) ? withoutNegativeZero(toUnit(value_rad, unit).toFixed(DIGITS[unit])) : "–";
}

/** Return the step of sliders, in the unit. */
export function angleStep(unit: AngleUnit): number {
  return unit === "deg" ? 0.1 : 0.001;
}

/** Return the unit as written after a number. */
export function unitSuffix(unit: AngleUnit): string {
  return unit === "deg" ? "°" : " rad";
}

function withoutNegativeZero(text: string): string {
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text;
}

/** Format a distance, as "3 mm" or "12.3 cm". */
export function distanceText(distance_m: number): string {
  if (distance_m < 0.01) return `${Math.max(1, Math.round(distance_m * 1000))} mm`;
  return `${(distance_m * 100).toFixed(1)} cm`;
}

/** Result of reading a typed number. */
export interface ParsedNumber {
  /** Number to use; null reverts to the one before. */
  value: number | null;
  /** Difference from the typed text, as a sentence; empty without one. */
  message: string;
}

/** Range of a number field, with its name and unit for messages. */
export interface NumberRange {
  name: string;
  lower: number;
  upper: number;
  /** Unit as written after a number. */
  unit: string;
  digits: number;
}

/** Read a typed number: revert invalid text, clamp to the limits, and explain either. */
export function parseNumber(text: string, range: NumberRange): ParsedNumber {
  const typed = text.trim().replace(",", ".").replace("−", "-");
  const value = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,3})?$/i.test(typed) ? Number(typed) : Number.NaN;
  if (!Number.isFinite(value)) {
    return { value: null, message: `${range.name}: “${truncated(text)}” is no number` };
  }
  if (value < range.lower) return atLimit(value, range.lower, "lower", range);
  if (value > range.upper) return atLimit(value, range.upper, "upper", range);
  return { value, message: "" };
}

function atLimit(value: number, limit: number, limit_name: string, range: NumberRange): ParsedNumber {
  const format = (number: number): string => `${Number(number.toFixed(range.digits))}${range.unit}`;
  const message = `${range.name}: ${format(value)} is beyond the ${limit_name} limit, ${format(limit)}`;
  return { value: limit, message };
}

function truncated(text: string): string {
  return text.length > 20 ? `${text.slice(0, 20)}…` : text;
}
