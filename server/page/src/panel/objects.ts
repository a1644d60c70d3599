import { addBox, moveObject, removeObject } from "../link/messages";
import type { Point, SceneObject } from "../state/state";
import { button, el, section } from "./dom";
import { gated } from "./gate";
import { numberField, type NumberField } from "./number-field";
import type { Page } from "./page";

/** Lengths of a box that can be set up on a table [m]. */
const SMALLEST_M = 0.001;
const LARGEST_M = 2;

/** A box that a gripper can hold, out of the arm's way [m]. */
const FIRST_SIZE_M: Point = [0.04, 0.04, 0.08];
const FIRST_PLACE_M: Point = [0.3, 0.15, 0.04];

const AXES = ["x", "y", "z"] as const;

/** The things of the planning scene: boxes can be added, all can be moved and removed. */
export function objects(page: Page): HTMLElement {
  const { store } = page;
  const list = el("ul", { class: "things", testid: "objects" });
  store.subscribe((state) => state.objects, (all) => list.replaceChildren(...all.map((object) => thing(page, object))));
  const shapes = el("input", { type: "checkbox", testid: "collision-shapes" });
  shapes.addEventListener("change", () => store.set({ collision_shapes: shapes.checked }));
  const show = el("label", { class: "line" }, shapes, "Show what is checked for contacts");
  return section("objects", "Scene", false, gated(page, "work", adding(page), list), show);
}

function lengths(name: string, first: Point, lower: number): { fields: NumberField[]; values: Point } {
  const values: Point = [...first];
  const fields = AXES.map((axis, index) => {
    const range = { name: `${name} ${axis}`, lower, upper: LARGEST_M, unit: " m", digits: 3 };
    const take = (value: number): void => void (values[index] = value);
    const field = numberField(`box-${name}-${axis}`, `${name} ${axis} in metres`, () => range, take);
    field.show(String(first[index]));
    return field;
  });
  return { fields, values };
}

function adding({ store, orders }: Page): HTMLElement {
  const size = lengths("size", FIRST_SIZE_M, SMALLEST_M);
  const place = lengths("place", FIRST_PLACE_M, -LARGEST_M);
  const add = button("Add box", "add-box", () => {
    orders.changeScene(addBox(freeName(store.state.objects), place.values, size.values));
  });
  const line = (title: string, fields: NumberField[]): HTMLElement => {
    return el("div", { class: "axes" }, el("span", { text: title }), ...fields.map(({ input }) => input));
  };
  const problems = [...size.fields, ...place.fields].map(({ problem }) => problem);
  return el("div", {}, line("size", size.fields), line("at", place.fields), ...problems, add);
}

function freeName(objects: readonly SceneObject[]): string {
  const taken = new Set(objects.map(({ id }) => id));
  let number = 1;
  while (taken.has(`box_${number}`)) number += 1;
  return `box_${number}`;
}

function thing({ store, orders }: Page, { id, held, position_m, orientation }: SceneObject): HTMLElement {
  if (held) return el("li", {}, el("b", { text: `${id} (held)` }));
  const choose = (): void => store.set({ selected_object: store.state.selected_object === id ? null : id });
  const name = button(id, `object-${id}`, choose, "Show the arrows that move it in the picture");
  const boxes = AXES.map((axis, index) => {
    const range = { name: `${id} ${axis}`, lower: -LARGEST_M, upper: LARGEST_M, unit: " m", digits: 3 };
    const field = numberField(`object-${id}-${axis}`, `${id}, ${axis} in metres`, () => range, (value) => {
      const moved: Point = [...position_m];
      moved[index] = value;
      orders.changeScene(moveObject(id, moved, orientation));
    });
    field.show(String(Number((position_m[index] ?? 0).toFixed(3))));
    return field;
  });
  const remove = button("Remove", `remove-${id}`, () => orders.changeScene(removeObject(id)));
  return el("li", {}, name, ...boxes.map(({ input }) => input), remove, ...boxes.map(({ problem }) => problem));
}
