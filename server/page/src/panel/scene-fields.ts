import { fromUnit, positionText, unitOf, type Unit } from "../logic/numbers";
import type { JointKind } from "../logic/robot-info";
import type { PageStore } from "../state/store";
import { el, numberField, setText } from "./dom";

/** Field for a length or an angle, labelled with its name and the unit that the user has chosen. */
export interface MeasureField {
  element: HTMLElement;
  problem: HTMLElement;
  /** Show a value [m or rad]. */
  show: (value: number) => void;
  /** Show label and value in the present unit. */
  refresh: () => void;
}

/** What a field measures. */
export interface Measure {
  testid: string;
  /** "prismatic" for a length, "revolute" for an angle, as joints have them. */
  kind: JointKind;
  /** Label, as "x". */
  name: string;
  /** Label for screen readers, as "Size x". */
  label: string;
  /** Limits [m or rad]. */
  lower: number;
  upper: number;
}

/** Create a field for a length or an angle; `take` is called with each typed value [m or rad]. */
export function measureField(store: PageStore, measure: Measure, take: (value: number) => void): MeasureField {
  const { testid, kind, name, label, lower, upper } = measure;
  let present = 0;
  const unit = (): Unit => unitOf(kind, store.state.settings.units);
  const range = (): Parameters<typeof numberField>[2] extends () => infer Range ? Range : never => {
    const { scale, suffix, digits } = unit();
    return { name: label, lower: lower * scale, upper: upper * scale, unit: suffix, digits };
  };
  const field = numberField(testid, label, range, (value) => {
    present = fromUnit(value, unit());
    take(present);
  });
  const caption = el("span");
  const show = (value: number): void => {
    present = value;
    field.show(trimmed(positionText(value, unit())));
  };
  const refresh = (): void => {
    const suffix = unit().suffix.trim();
    setText(caption, `${name} (${suffix})`);
    field.input.setAttribute("aria-label", `${label} (${suffix})`);
    show(present);
  };
  refresh();
  return { element: el("label", { class: "measure" }, caption, field.input), problem: field.problem, show, refresh };
}

/** Return a number without zeros after its last decimal. */
function trimmed(text: string): string {
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

/** Create a line of fields with its title, and their problems below. */
export function measureLine(title: string, fields: readonly MeasureField[]): HTMLElement {
  const line = el("div", { class: "measures", role: "group", label: title });
  line.append(el("span", { class: "measures-title", text: title }), ...fields.map(({ element }) => element));
  return el("div", {}, line, ...fields.map(({ problem }) => problem));
}
