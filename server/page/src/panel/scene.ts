import { holderOf } from "../logic/scene-attach";
import { MAX_NAME_LENGTH, MAX_PLACE_M, MAX_SIZE_M, MIN_SIZE_M, nameProblem, sizesOf, withSize } from "../logic/scene-objects";
import { AXES, ROTATIONS, quaternionOf, rollPitchYawOf, type RollPitchYaw } from "../logic/rotations";
import type { Color, Point, SceneObject, State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, keyedList, section, setText, type ListItem } from "./dom";
import { measureField, measureLine, type MeasureField } from "./scene-fields";

/** Colour of the field while an object has none of its own: that of the theme's objects. */
const THEME_COLOR = "#6f9a5c";

/** Create the line that stays above the sections: undo, and the server's answer to the last change. */
export function sceneBar(context: PanelContext): HTMLElement {
  const { store, sceneEditor } = context;
  const undo = button(t("world.undo"), "undo-scene", () => void sceneEditor.undo());
  const result = el("span", { testid: "scene-result", role: "status" });
  store.subscribe(({ editing }) => editing.history.length, (count) => (undo.disabled = count === 0));
  store.subscribe(({ editing }) => editing.result, (text) => setText(result, text));
  return el("div", { class: "scene-bar" }, permissionFieldset(context, "work", undo), result);
}

/** Create the section of the objects: their list, and the selected one's values. */
export function objectsSection(context: PanelContext): HTMLElement {
  const { store } = context;
  const list = el("ul", { class: "things", testid: "objects" });
  const empty = el("p", { class: "hint", testid: "objects-empty", text: t("world.empty") });
  const editor_host = el("div", { testid: "object-editor" });
  const showItems = keyedList<SceneObject>(list, ({ id }) => id, ({ id }) => objectItem(store, id));
  let editor: ObjectEditor | null = null;
  const show = (state: State): void => {
    const { objects, selected_object } = state;
    const selected = objects.find(({ id }) => id === selected_object) ?? null;
    empty.hidden = objects.length > 0;
    showItems(objects);
    if (selected === null || editor === null || !editor.isFor(selected)) {
      editor = selected && new ObjectEditor(context, selected);
      editor_host.replaceChildren(...(editor ? [editor.element] : []));
    }
    if (selected !== null) editor?.show(selected);
  };
  store.watch(["objects", "selected_object"], show);
  store.subscribe(({ settings }) => settings.units, () => editor?.refresh());
  const shapes = el("input", { type: "checkbox", testid: "collision-shapes" });
  shapes.addEventListener("change", () => store.set({ collision_shapes: shapes.checked }));
  const contacts = el("label", { class: "line" }, shapes, t("world.contacts"));
  const gate = permissionFieldset(context, "work", empty, list, editor_host);
  return section("objects", t("world.objects"), true, gate, contacts);
}

function objectItem(store: PageStore, id: string): ListItem<SceneObject> {
  const select = (): void => store.set({ selected_object: store.state.selected_object === id ? null : id });
  const name = button(id, `object-${id}`, select);
  const held = el("small", { class: "hint" });
  const show = ({ attached, frame }: SceneObject): void => {
    name.setAttribute("aria-pressed", String(store.state.selected_object === id));
    setText(held, attached ? t("world.held", { link: frame }) : "");
  };
  return { element: el("li", {}, name, held), show };
}

/** Fields and buttons of the selected object. */
class ObjectEditor {
  readonly element: HTMLElement;
  private readonly fields: MeasureField[] = [];
  private readonly values: ((object: SceneObject) => number)[] = [];
  private readonly color = el("input", { type: "color", testid: "object-color", label: t("world.color") });

  constructor(
    private readonly context: PanelContext,
    private object: SceneObject,
  ) {
    this.element = el("div", { class: "object-editor", role: "group", label: object.id });
    this.element.append(this.nameLine());
    // What is held moves with its link.
    if (!object.attached) this.element.append(this.sizes(), this.place(), this.rotation(), this.arrows());
    this.element.append(this.colorLine(), this.buttons());
  }

  /** Return true while the fields are those of an object. */
  isFor({ id, attached, shapes }: SceneObject): boolean {
    const kinds = (all: SceneObject["shapes"]): string => all.map(({ kind }) => kind).join();
    return id === this.object.id && attached === this.object.attached && kinds(shapes) === kinds(this.object.shapes);
  }

  /** Show an object's values. */
  show(object: SceneObject): void {
    this.object = object;
    this.fields.forEach((field, index) => field.show(this.values[index]?.(object) ?? 0));
    this.color.value = object.color === null ? THEME_COLOR : hexOf(object.color);
  }

  /** Show the values in the present units. */
  refresh(): void {
    for (const field of this.fields) field.refresh();
  }

  private nameLine(): HTMLElement {
    const { store, sceneEditor } = this.context;
    const { id } = this.object;
    const name = el("input", { type: "text", testid: "object-name", attributes: { autocomplete: "off", spellcheck: "false" } });
    name.value = id;
    const problem = el("small", { class: "problem", testid: "object-name-problem", role: "alert" });
    name.addEventListener("change", () => {
      const wanted = name.value.trim();
      const reason = nameProblem(wanted, id, store.state.objects);
      setText(problem, reason === "" ? "" : t(`world.name.${reason}`, { name: wanted, limit: MAX_NAME_LENGTH }));
      if (reason !== "") name.value = id;
      else if (wanted !== id) void sceneEditor.rename(this.object, wanted);
    });
    return el("div", {}, el("label", { class: "line" }, t("world.name"), name), problem);
  }

  private sizes(): HTMLElement {
    const { shapes } = this.object;
    const [only] = shapes;
    const sizes = shapes.length === 1 && only ? sizesOf(only) : [];
    if (sizes.length === 0) return el("span");
    const range = { lower: MIN_SIZE_M, upper: MAX_SIZE_M, kind: "prismatic" } as const;
    const fields = sizes.map(({ name }, index) => {
      const measure = { ...range, testid: `object-size-${name}`, name: t(`world.size.${name}`), label: `${t("world.size")} ${t(`world.size.${name}`)}` };
      const take = (value: number): void => void this.context.sceneEditor.add(withSize(this.object, index, value));
      return this.field(measure, (object) => object.shapes[0]?.dimensions[index] ?? 0, take);
    });
    return measureLine(t("world.size"), fields);
  }

  private place(): HTMLElement {
    const range = { lower: -MAX_PLACE_M, upper: MAX_PLACE_M, kind: "prismatic" } as const;
    const fields = AXES.map((axis, index) => {
      const measure = { ...range, testid: `object-${axis}`, name: axis, label: `${t("world.middle")} ${axis}` };
      return this.field(measure, ({ position_m }) => position_m[index] ?? 0, (value) => {
        const position_m: Point = [...this.object.position_m];
        position_m[index] = value;
        void this.context.sceneEditor.move(this.object.id, position_m, this.object.orientation);
      });
    });
    return measureLine(t("world.middle"), fields);
  }

  private rotation(): HTMLElement {
    const fields = ROTATIONS.map(([name, limit], index) => {
      const label = t(`world.${name}`);
      const measure = { testid: `object-${name}`, kind: "revolute", name: label, label, lower: -limit, upper: limit } as const;
      return this.field(measure, ({ orientation }) => rollPitchYawOf(orientation)[index] ?? 0, (value) => {
        const angles: RollPitchYaw = [...rollPitchYawOf(this.object.orientation)];
        angles[index] = value;
        void this.context.sceneEditor.move(this.object.id, this.object.position_m, quaternionOf(angles));
      });
    });
    return measureLine(t("world.turn"), fields);
  }

  private field(measure: Parameters<typeof measureField>[1], value: (object: SceneObject) => number, take: (value: number) => void): MeasureField {
    const field = measureField(this.context.store, measure, take);
    this.fields.push(field);
    this.values.push(value);
    return field;
  }

  /** Create the choice of the arrows in the picture. */
  private arrows(): HTMLElement {
    const { store, sceneEditor } = this.context;
    const host = el("div", { class: "chips", role: "radiogroup", label: t("world.arrows") });
    host.append(el("span", { class: "measures-title", text: t("world.arrows") }));
    for (const mode of ["translate", "rotate"] as const) {
      const input = el("input", { type: "radio", testid: `arrows-${mode}`, attributes: { name: "scene-arrows" } });
      input.checked = store.state.editing.arrows === mode;
      input.addEventListener("change", () => sceneEditor.edit({ arrows: mode }));
      host.append(el("label", { class: "choice" }, input, t(`world.arrows.${mode}`)));
    }
    return host;
  }

  private colorLine(): HTMLElement {
    this.color.addEventListener("change", () => void this.context.sceneEditor.paint(this.object.id, colorOf(this.color.value)));
    return el("label", { class: "line" }, t("world.color"), this.color);
  }

  private buttons(): HTMLElement {
    const { store, sceneEditor } = this.context;
    const { attached, id } = this.object;
    const remove = button(t("world.remove"), `remove-${id}`, () => void sceneEditor.remove(this.object));
    if (attached) {
      const detach = button(t("world.detach"), "detach-object", () => void sceneEditor.detach(id), t("world.detach.hint"));
      return el("div", { class: "buttons" }, detach, remove);
    }
    const link = holderOf(store.state)?.link ?? "";
    const attach = button(t("world.attach"), "attach-object", () => void sceneEditor.attach(id), t("world.attach.hint", { link }));
    attach.disabled = link === "";
    const copy = button(t("world.duplicate"), "duplicate-object", () => void sceneEditor.duplicate(this.object));
    return el("div", { class: "buttons" }, attach, copy, remove);
  }
}

function hexOf(color: Color): string {
  const two = (part: number): string => Math.round(Math.min(Math.max(part, 0), 1) * 255).toString(16).padStart(2, "0");
  return `#${color.slice(0, 3).map(two).join("")}`;
}

function colorOf(hex: string): Color {
  const part = (at: number): number => Number.parseInt(hex.slice(at, at + 2), 16) / 255;
  return [part(1), part(3), part(5), 1];
}
