import { addBox, moveObject, removeObject } from "../link/messages";
import type { Point, SceneObject } from "../state/state";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, numberField, section, type NumberField } from "./dom";

/** Limits of a box's edges and coordinates on a table [m]. */
const MIN_LENGTH_M = 0.001;
const MAX_LENGTH_M = 2;

/** Default box: of a size that the gripper can hold, out of the arm's way [m]. */
const DEFAULT_SIZE_M: Point = [0.04, 0.04, 0.08];
const DEFAULT_POSITION_M: Point = [0.3, 0.15, 0.04];

const AXES = ["x", "y", "z"] as const;

/** Create the section of the planning scene, where boxes are added, and objects moved and removed. */
export function sceneSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("ul", { class: "things", testid: "objects" });
  store.subscribe(
    (state) => state.objects,
    (objects) => list.replaceChildren(...objects.map((object) => objectItem(context, object))),
  );
  const shapes = el("input", { type: "checkbox", testid: "collision-shapes" });
  shapes.addEventListener("change", () => store.set({ collision_shapes: shapes.checked }));
  const show = el("label", { class: "line" }, shapes, "Show what is checked for contacts");
  return section("objects", "Scene", false, permissionFieldset(context, "work", addBoxForm(context), list), show);
}

function lengthFields(name: string, initial: Point, lower: number): { fields: NumberField[]; values: Point } {
  const values: Point = [...initial];
  const fields = AXES.map((axis, index) => {
    const range = { name: `${name} ${axis}`, lower, upper: MAX_LENGTH_M, unit: " m", digits: 3 };
    const take = (value: number): void => void (values[index] = value);
    const field = numberField(`box-${name}-${axis}`, `${name} ${axis} in metres`, () => range, take);
    field.show(String(initial[index]));
    return field;
  });
  return { fields, values };
}

function addBoxForm({ store, commands }: PanelContext): HTMLElement {
  const size = lengthFields("size", DEFAULT_SIZE_M, MIN_LENGTH_M);
  const place = lengthFields("place", DEFAULT_POSITION_M, -MAX_LENGTH_M);
  const add = button("Add box", "add-box", () => {
    commands.publishCollisionObject(addBox(freeName(store.state.objects), place.values, size.values));
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

function objectItem({ store, commands }: PanelContext, object: SceneObject): HTMLElement {
  const { id, attached, position_m, orientation } = object;
  if (attached) return el("li", {}, el("b", { text: `${id} (held)` }));
  const choose = (): void => store.set({ selected_object: store.state.selected_object === id ? null : id });
  const name = button(id, `object-${id}`, choose, "Show the arrows that move it in the picture");
  const boxes = AXES.map((axis, index) => {
    const range = { name: `${id} ${axis}`, lower: -MAX_LENGTH_M, upper: MAX_LENGTH_M, unit: " m", digits: 3 };
    const field = numberField(`object-${id}-${axis}`, `${id}, ${axis} in metres`, () => range, (value) => {
      const moved: Point = [...position_m];
      moved[index] = value;
      commands.publishCollisionObject(moveObject(id, moved, orientation));
    });
    field.show(String(Number((position_m[index] ?? 0).toFixed(3))));
    return field;
  });
  const remove = button("Remove", `remove-${id}`, () => commands.publishCollisionObject(removeObject(id)));
  return el("li", {}, name, ...boxes.map(({ input }) => input), remove, ...boxes.map(({ problem }) => problem));
}
