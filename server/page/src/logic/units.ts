const DEGREES = 180 / Math.PI;

/** Which unit people read and type angles in. */
export type AngleUnit = "deg" | "rad";

/** An angle as a number in the unit. */
export function toUnit(value_rad: number, unit: AngleUnit): number {
  return unit === "deg" ? value_rad * DEGREES : value_rad;
}

/** An angle in the unit as radians. */
export function fromUnit(value: number, unit: AngleUnit): number {
  return unit === "deg" ? value / DEGREES : value;
}

/** Digits behind the point that a servo's resolution of 0.0015 rad deserves. */
const DIGITS: Record<AngleUnit, number> = { deg: 1, rad: 3 };

/** An angle as text, without the unit; a dash for what is no number. */
export function angleText(value_rad: number, unit: AngleUnit): string {
  return Number.isFinite(value_rad) ? tidy(toUnit(value_rad, unit).toFixed(DIGITS[unit])) : "–";
}

/** The step of sliders and arrows, in the unit. */
export function angleStep(unit: AngleUnit): number {
  return unit === "deg" ? 0.1 : 0.001;
}

/** How the unit is written behind a number. */
export function unitSign(unit: AngleUnit): string {
  return unit === "deg" ? "°" : " rad";
}

function tidy(text: string): string {
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text;
}
