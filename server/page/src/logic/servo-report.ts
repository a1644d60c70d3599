import type { ServoState } from "../state/state";
import { t } from "../texts/texts";

export interface RegisterValue {
  name: string;
  value: string;
  /** Value that the servo's profile or the calibration expects; empty where the servo has it, or the server does not tell. */
  expected: string;
  /** True for a register with another value than expected, or that a warning names. */
  differs: boolean;
}

export interface ErrorCount {
  kind: string;
  count: number;
}

/** Details of a servo among the values of its status. */
export interface ServoReport {
  registers: RegisterValue[];
  errors: ErrorCount[];
  advice: string[];
}

/** Keys of the values: `register/P_COEFFICIENT`, `expected/P_COEFFICIENT`, `error/timeout`. */
const REGISTER = "register/";
const EXPECTED = "expected/";
const ERROR = "error/";

export function servoReport({ level, message, values }: ServoState): ServoReport {
  const named = (prefix: string): [string, string][] => {
    const pairs = Object.entries(values).filter(([key]) => key.startsWith(prefix));
    return pairs.map(([key, value]) => [key.slice(prefix.length), value]);
  };
  const warned = new Set(level === 0 ? [] : message.split(/\W+/));
  const registers = named(REGISTER).map(([name, value]): RegisterValue => {
    const expected = values[EXPECTED + name] ?? "";
    return { name, value, expected, differs: expected !== "" || warned.has(name) };
  });
  const errors = named(ERROR).map(([kind, text]) => ({ kind, count: Number(text) || 0 }));
  return {
    registers: registers.sort((one, other) => Number(other.differs) - Number(one.differs)),
    errors: errors.filter(({ count }) => count > 0).sort((one, other) => other.count - one.count),
    advice: (values.advice ?? "").split("\n").map((line) => line.trim()).filter((line) => line !== ""),
  };
}

/** Return what differs and what goes wrong at a servo, and what to do about it: a sentence each. */
export function complaints(servo: ServoState): string[] {
  const { registers, advice } = servoReport(servo);
  const warnings = servo.level === 0 ? [] : servo.message.split("; ");
  const different = registers.filter(({ expected }) => expected !== "");
  const differences = different.map(({ name, value, expected }) => t("servos.differs", { name, value, expected }));
  // The server's warnings tell of the same registers, and what the difference means.
  const told = [...warnings, ...advice].join(" ");
  const untold = differences.filter((_, index) => !told.includes(different[index]?.name ?? ""));
  return [...warnings, ...untold, ...advice];
}

/** Return a current without its sign [A], with two decimals; a dash without a number. */
export function amperes(text: string | undefined): string {
  const value = Number(text ?? Number.NaN);
  return Number.isFinite(value) ? Math.abs(value).toFixed(2) : "–";
}

/** Return a fraction in percent; a dash without a number. */
export function percent(text: string | undefined): string {
  const value = Number(text ?? Number.NaN);
  return Number.isFinite(value) ? `${Math.round(100 * value)} %` : "–";
}
