import { FILE_UNITS, fileProblem, makeMesh, MESH_KINDS, MAX_FILE_BYTES } from "../logic/scene-mesh";
import { distanceText, type UnitSystem } from "../logic/numbers";
import { AXES } from "../logic/rotations";
import {
  INITIAL_SIZES_M,
  MAX_PLACE_M,
  MAX_SIZE_M,
  meshShape,
  MIN_SIZE_M,
  newObject,
  sizedShape,
  SIZED_KINDS,
  sizesOf,
  type SizedKind,
} from "../logic/scene-objects";
import type { NewObject, Point, Shape } from "../state/state";
import { t, type TextKey } from "../texts/texts";
import { readCorners } from "../view/mesh-file";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, option, section, setText } from "./dom";
import { measureField, measureLine, type MeasureField } from "./scene-fields";
import "./scene.css";

/** Place where a typed object stands at first: out of the arm's way [m]. */
const INITIAL_PLACE_M: Point = [0.3, 0.15, 0.04];

const KINDS = [...SIZED_KINDS, "mesh"] as const;
type Kind = (typeof KINDS)[number];

/** Read mesh of a file, about its middle. */
interface LoadedMesh {
  name: string;
  shape: Shape;
}

/** Create the section where objects are added: shape and sizes first, then the place by a click or by numbers. */
export function addObjectSection(context: PanelContext): HTMLElement {
  return section("add-object", t("world.add"), true, permissionFieldset(context, "work", new AddForm(context).element));
}

/** Form of a new object. */
class AddForm {
  readonly element: HTMLElement;
  private readonly sizes_m: Record<SizedKind, number[]>;
  private readonly position_m: Point = [...INITIAL_PLACE_M];
  private readonly size_host = el("div");
  private readonly file_form: HTMLElement;
  private readonly file_result = el("p", { class: "hint", testid: "mesh-result", role: "status" });
  private readonly click: HTMLButtonElement;
  private readonly type_in: HTMLButtonElement;
  private readonly hint = el("p", { class: "hint", testid: "placing-hint", role: "status" });
  private kind: Kind = "box";
  private mesh: LoadedMesh | null = null;
  private file: File | null = null;
  private unit = "mm";
  private size_fields: MeasureField[] = [];
  private readonly place_fields: MeasureField[];

  constructor(private readonly context: PanelContext) {
    const { store, sceneEditor } = context;
    this.sizes_m = { box: [...INITIAL_SIZES_M.box], sphere: [...INITIAL_SIZES_M.sphere], cylinder: [...INITIAL_SIZES_M.cylinder] };
    this.file_form = this.createFileForm();
    this.click = button("", "place-object", () => this.togglePlacing());
    this.click.classList.add("primary");
    this.type_in = button(t("world.add_here"), "add-object", () => {
      const chosen = this.chosen();
      if (chosen !== null) void sceneEditor.add(newObject(chosen, [...this.position_m], store.state.objects));
    });
    this.place_fields = AXES.map((axis, index) => {
      const measure = { testid: `place-${axis}`, kind: "prismatic", name: axis, label: `${t("world.middle")} ${axis}` } as const;
      const field = measureField(store, { ...measure, lower: -MAX_PLACE_M, upper: MAX_PLACE_M }, (value) => void (this.position_m[index] = value));
      field.show(this.position_m[index] ?? 0);
      return field;
    });
    this.element = el("div", {}, this.kindChoice(), this.size_host, this.file_form, el("div", { class: "buttons" }, this.click), this.hint);
    this.element.append(measureLine(t("world.middle"), this.place_fields), el("div", { class: "buttons" }, this.type_in));
    store.subscribe(({ editing }) => editing.placing, () => this.show());
    store.subscribe(({ settings }) => settings.units, () => [...this.size_fields, ...this.place_fields].forEach((field) => field.refresh()));
    this.choose("box");
  }

  private kindChoice(): HTMLElement {
    const host = el("div", { class: "chips", role: "radiogroup", label: t("world.shape") });
    for (const kind of KINDS) {
      const input = el("input", { type: "radio", testid: `shape-${kind}`, attributes: { name: "scene-shape", value: kind } });
      input.checked = kind === this.kind;
      input.addEventListener("change", () => this.choose(kind));
      host.append(el("label", { class: "choice" }, input, t(`world.kind.${kind}`)));
    }
    return host;
  }

  private choose(kind: Kind): void {
    this.kind = kind;
    this.file_form.hidden = kind !== "mesh";
    this.size_fields = kind === "mesh" ? [] : this.createSizes(kind);
    this.size_host.replaceChildren(...(kind === "mesh" ? [] : [measureLine(t("world.size"), this.size_fields)]));
    this.changed();
  }

  private createSizes(kind: SizedKind): MeasureField[] {
    return sizesOf({ kind, dimensions: this.sizes_m[kind] }).map(({ name, value_m }, index) => {
      const label = `${t("world.size")} ${t(`world.size.${name}`)}`;
      const measure = { testid: `size-${name}`, kind: "prismatic", name: t(`world.size.${name}`), label } as const;
      const field = measureField(this.context.store, { ...measure, lower: MIN_SIZE_M, upper: MAX_SIZE_M }, (value) => {
        this.sizes_m[kind][index] = value;
        this.changed();
      });
      field.show(value_m);
      return field;
    });
  }

  private createFileForm(): HTMLElement {
    const input = el("input", { type: "file", testid: "mesh-file", label: t("world.file") });
    input.accept = MESH_KINDS.map((kind) => `.${kind}`).join();
    input.addEventListener("change", () => {
      this.file = input.files?.[0] ?? null;
      void this.readFile();
    });
    const units = el("select", { testid: "mesh-unit", label: t("world.file.unit") });
    units.append(...Object.keys(FILE_UNITS).map((unit) => option(unit, unit)));
    units.addEventListener("change", () => {
      this.unit = units.value;
      void this.readFile();
    });
    const limit = el("small", { class: "hint", text: t("world.file.limit", { limit: MAX_FILE_BYTES / 1e6 }) });
    return el("div", {}, input, el("label", { class: "line" }, `${t("world.file.unit")} `, units), limit, this.file_result);
  }

  /** Read the chosen file; one that is too large is refused by its size, before a byte of it is read. */
  private async readFile(): Promise<void> {
    this.mesh = null;
    this.changed();
    const { file, unit } = this;
    if (file === null) return setText(this.file_result, "");
    const problem = fileProblem(file.name, file.size);
    if (problem !== null) return this.tell(t(`world.file.${problem.key}`, problem.values), true);
    this.tell(t("world.file.reading", { name: file.name }), false);
    try {
      const bytes = await file.arrayBuffer();
      const scale_m = file.name.toLowerCase().endsWith(".dae") ? 1 : (FILE_UNITS[unit] ?? 1);
      const { vertices, triangles, deviation_m } = makeMesh(await readCorners(file.name, bytes), scale_m);
      if (file !== this.file || unit !== this.unit) return;
      this.mesh = { name: objectName(file.name), shape: meshShape(vertices, triangles) };
      const { units } = this.context.store.state.settings;
      const values = { name: file.name, count: triangles.length, size: sizeText(vertices, units), deviation: distanceText(deviation_m, units) };
      this.tell(t(deviation_m > 0 ? "world.file.simplified" : "world.file.ready", values), false);
    } catch (error) {
      this.tell(t("world.file.broken", { name: file.name, reason: (error as Error).message }), true);
    }
    this.changed();
  }

  private tell(text: string, is_problem: boolean): void {
    setText(this.file_result, text);
    this.file_result.dataset["off"] = String(is_problem);
  }

  private chosen(): NewObject | null {
    if (this.kind === "mesh") return this.mesh;
    return { name: this.kind, shape: sizedShape(this.kind, this.sizes_m[this.kind]) };
  }

  /** Give a changed shape to the click that is awaited. */
  private changed(): void {
    if (this.context.store.state.editing.placing !== null) this.context.sceneEditor.edit({ placing: this.chosen() });
    this.show();
  }

  private togglePlacing(): void {
    const is_placing = this.context.store.state.editing.placing !== null;
    this.context.sceneEditor.edit({ placing: is_placing ? null : this.chosen(), clicked: null });
  }

  private show(): void {
    const is_placing = this.context.store.state.editing.placing !== null;
    setText(this.click, t(is_placing ? "world.place.cancel" : "world.place"));
    this.click.setAttribute("aria-pressed", String(is_placing));
    this.click.disabled = this.type_in.disabled = this.chosen() === null;
    const key: TextKey = is_placing ? "world.place.now" : "world.place.hint";
    setText(this.hint, t(key));
  }
}

/** Return the name of an object from that of its file. */
function objectName(file_name: string): string {
  return file_name.replace(/\.[^.]*$/, "").replace(/[^\p{L}\p{N}_-]+/gu, "_").slice(0, 40) || "mesh";
}

function sizeText(vertices: readonly Point[], units: UnitSystem): string {
  // The mesh is about its middle.
  const sizes = [0, 1, 2].map((axis) => 2 * vertices.reduce((most, vertex) => Math.max(most, vertex[axis] ?? 0), 0));
  return sizes.map((size_m) => distanceText(size_m, units)).join(" × ");
}
