import { t } from "../texts/texts";
import type { JointKind } from "./robot-info";

/** Units that the user has chosen: degrees and millimetres, or radians and metres. */
export type UnitSystem = "deg" | "rad";

/** Unit of displayed and typed positions of a joint. */
export interface Unit {
  suffix: string;
  /** Units per radian or metre. */
  scale: number;
  /** Decimals of displayed numbers, from the servo's resolution of 0.0015 rad, and a tenth of a millimetre. */
  digits: number;
  step: number;
}

const ANGLES: Record<UnitSystem, Unit> = {
  deg: { suffix: "°", scale: 180 / Math.PI, digits: 1, step: 0.1 },
  rad: { suffix: " rad", scale: 1, digits: 3, step: 0.001 },
};
const LENGTHS: Record<UnitSystem, Unit> = {
  deg: { suffix: " mm", scale: 1000, digits: 1, step: 0.1 },
  rad: { suffix: " m", scale: 1, digits: 4, step: 0.0001 },
};

export function unitOf(kind: JointKind, system: UnitSystem): Unit {
  return (kind === "prismatic" ? LENGTHS : ANGLES)[system];
}

/** Format a position without its unit; a dash where it is not finite. */
export function positionText(value: number, unit: Unit): string {
  // Without the sign of a negative zero.
  return Number.isFinite(value) ? (value * unit.scale).toFixed(unit.digits).replace(/^-(?=0\.?0*$)/, "") : "–";
}

/** Format a distance to the millimetre, as "123 mm" or "0.123 m"; one that is there is never 0. */
export function distanceText(distance_m: number, system: UnitSystem): string {
  const millimetres = Math.max(1, Math.round(distance_m * 1000));
  return ((millimetres / 1000) * LENGTHS[system].scale).toFixed(system === "deg" ? 0 : 3) + LENGTHS[system].suffix;
}

/** Numbers with their unit in a sentence: one, a point in parentheses, a range, or some joints; not a speed, as rad/s. */
const MEASURES = /(?<![\w.])\(?-?\d+(?:\.\d+)?(?:e-?\d+)?(?:(?:, (?:\w+ )?| to )-?\d+(?:\.\d+)?(?:e-?\d+)?)*\)? (?:cm|mm|m|rad)(?![\w/])/g;
const METRES: Record<string, number> = { m: 1, cm: 0.01, mm: 0.001 };

/** Return a sentence of the server, which measures in radians, metres and centimetres, in the chosen units. */
export function inUnits(sentence: string, system: UnitSystem): string {
  return sentence.replace(MEASURES, (measure) => {
    const name = measure.slice(measure.lastIndexOf(" ") + 1);
    const { scale, suffix, digits } = (name === "rad" ? ANGLES : LENGTHS)[system];
    const converted = (number: string): string => String(Number((Number(number) * (METRES[name] ?? 1) * scale).toFixed(digits)));
    return measure.slice(0, -name.length - 1).replace(/(?<!\w)-?\d+(?:\.\d+)?(?:e-?\d+)?/g, converted) + suffix;
  });
}

export interface ParsedNumber {
  /** Number to use; null reverts to the one before. */
  value: number | null;
  /** Difference from the typed text, as a sentence; empty without one. */
  message: string;
}

export interface NumberRange {
  name: string;
  lower: number;
  upper: number;
  unit: string;
  digits: number;
}

/** Read a typed number: revert invalid text, clamp to the limits, and explain either. */
export function parseNumber(text: string, range: NumberRange): ParsedNumber {
  const typed = text.trim().replace(",", ".").replace("−", "-");
  const value = /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,3})?$/i.test(typed) ? Number(typed) : Number.NaN;
  if (!Number.isFinite(value)) {
    return { value: null, message: t("number.none", { name: range.name, text: text.length > 20 ? `${text.slice(0, 20)}…` : text }) };
  }
  if (value < range.lower) return atLimit(value, range.lower, range);
  if (value > range.upper) return atLimit(value, range.upper, range);
  return { value, message: "" };
}

function atLimit(value: number, limit: number, range: NumberRange): ParsedNumber {
  const format = (number: number): string => `${Number(number.toFixed(range.digits))}${range.unit}`;
  const [typed, lower, upper] = [format(value), format(range.lower), format(range.upper)];
  return { value: limit, message: t("number.outside", { name: range.name, value: typed, lower, upper }) };
}
