import { distanceText } from "../logic/ghost";
import { paced } from "../state/pace";
import type { Point, State, TargetState } from "../state/state";
import { wishPoint } from "../state/wishes";
import { el, section, write } from "./dom";
import { numberField } from "./number-field";
import type { Page } from "./page";

/** Farther away than any small arm reaches [m]. */
const FARTHEST_M = 2;

/** Numbers that change faster than this cannot be read [ms]. */
const READABLE_MS = 100;

const AXES = ["x", "y", "z"] as const;

/** The target in numbers, and whether the arm can be there. */
export function target(page: Page): HTMLElement {
  const { store } = page;
  const fields = AXES.map((axis, index) => {
    const range = { name: axis, lower: -FARTHEST_M, upper: FARTHEST_M, unit: " m", digits: 4 };
    return numberField(`target-${axis}`, `target ${axis} in metres`, () => range, (value) => {
      const position_m = [...place(store.state)] as Point;
      position_m[index] = value;
      wishPoint(store, position_m);
    });
  });
  const words = el("p", { class: "hint", testid: "target-state", role: "status" });
  const show = paced<State>(READABLE_MS, (state) => {
    place(state).forEach((value, index) => fields[index]?.show(Number.isFinite(value) ? value.toFixed(4) : ""));
    write(words, state.wish.kind === "target" ? reachWords(state.target) : "Drag the arrows at the tool, or type a point.");
    words.dataset["off"] = String(state.wish.kind === "target" && state.target.reachable === false);
  });
  for (const part of ["target", "wish", "tool_m"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const boxes = AXES.map((axis, index) => el("label", {}, `${axis} `, fields[index]?.input ?? ""));
  const problems = fields.map(({ problem }) => problem);
  return section("target", "Target of the tool (m)", true, el("div", { class: "axes" }, ...boxes), ...problems, words);
}

function place({ wish, target: { position_m }, tool_m }: State): Point {
  return (wish.kind === "target" ? position_m : tool_m) ?? [0, 0, 0];
}

function reachWords({ reachable, distance_m }: TargetState): string {
  if (reachable === null) return "…";
  if (reachable) return "The arm can be there.";
  if (distance_m > 0) return `Out of reach: the nearest the tool comes is ${distanceText(distance_m)} away.`;
  return "The arm would touch something there.";
}
