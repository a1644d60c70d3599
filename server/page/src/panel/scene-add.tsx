import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { distanceText, type UnitSystem } from "../logic/numbers";
import { AXES } from "../logic/rotations";
import { FILE_UNITS, fileProblem, makeMesh, MAX_FILE_BYTES, MESH_KINDS } from "../logic/scene-mesh";
import { INITIAL_SIZES_M, MAX_PLACE_M, MAX_SIZE_M, meshShape, MIN_SIZE_M, newObject, sizedShape, SIZED_KINDS, sizesOf, type SizedKind } from "../logic/scene-objects";
import type { NewObject, Point, Shape } from "../state/state";
import { t } from "../texts/texts";
import { readCorners } from "../view/meshes";
import { Button, Gate, Line, MeasureField, MeasureLine, Radios, Section, Select, usePage } from "./ui";
import "./scene.css";

/** Place where a typed object stands at first: out of the arm's way [m]. */
const INITIAL_PLACE_M: Point = [0.3, 0.15, 0.04];

const KINDS = [...SIZED_KINDS, "mesh"] as const;
type Kind = (typeof KINDS)[number];

export function AddObject(): JSX.Element {
  const { store, sceneEditor } = usePage();
  const [kind, choose] = useState<Kind>("box");
  const [sizes_m, setSizes] = useState<Record<SizedKind, readonly number[]>>(INITIAL_SIZES_M);
  const [position_m, setPosition] = useState(INITIAL_PLACE_M);
  const [mesh, setMesh] = useState<NewObject | null>(null);
  const chosen: NewObject | null = kind === "mesh" ? mesh : { name: kind, shape: sizedShape(kind, sizes_m[kind]) };
  const is_placing = store.state.editing.placing !== null;
  // A changed shape goes to the click that is awaited.
  useEffect(() => {
    if (store.state.editing.placing !== null) sceneEditor.edit({ placing: chosen });
  }, [kind, sizes_m, mesh]);
  return (
    <Section name="add-object" title={t("world.add")}>
      <Gate to="work">
        <Radios testid="shape" label={t("world.shape")} value={kind} options={KINDS.map((each) => [each, t(`world.kind.${each}`)])} take={(each) => choose(KINDS.find((known) => known === each) ?? "box")} />
        {kind !== "mesh" && (
          <MeasureLine key={kind} title={t("world.size")}>
            {sizesOf({ kind, dimensions: [...sizes_m[kind]] }).map(({ name, value_m }, index) => (
              <MeasureField
                key={name} testid={`size-${name}`} name={t(`world.size.${name}`)} label={`${t("world.size")} ${t(`world.size.${name}`)}`} lower={MIN_SIZE_M} upper={MAX_SIZE_M}
                value={value_m} take={(value) => setSizes((sizes) => ({ ...sizes, [kind]: sizes[kind].with(index, value) }))}
              />
            ))}
          </MeasureLine>
        )}
        <MeshForm hidden={kind !== "mesh"} take={setMesh} />
        <div class="buttons">
          <Button testid="place-object" class="primary" aria-pressed={is_placing} disabled={chosen === null} press={() => sceneEditor.edit({ placing: is_placing ? null : chosen, clicked: null })}>{t(is_placing ? "world.place.cancel" : "world.place")}</Button>
        </div>
        <p class="hint" data-testid="placing-hint" role="status">{t(is_placing ? "world.place.now" : "world.place.hint")}</p>
        <MeasureLine title={t("world.middle")}>
          {AXES.map((axis, index) => (
            <MeasureField
              key={axis} testid={`place-${axis}`} name={axis} label={`${t("world.middle")} ${axis}`} lower={-MAX_PLACE_M} upper={MAX_PLACE_M}
              value={position_m[index] ?? 0} take={(value) => setPosition((position) => position.with(index, value) as Point)}
            />
          ))}
        </MeasureLine>
        <div class="buttons">
          <Button testid="add-object" disabled={chosen === null} press={() => chosen && void sceneEditor.add(newObject(chosen, [...position_m], store.state.objects))}>{t("world.add_here")}</Button>
        </div>
      </Gate>
    </Section>
  );
}

/** File of a mesh, with its unit; `take` gets the mesh about its middle, and null while there is none. */
function MeshForm({ hidden, take }: { hidden: boolean; take: (mesh: NewObject | null) => void }): JSX.Element {
  const { store } = usePage();
  const [file, setFile] = useState<File | null>(null);
  const [unit, setUnit] = useState("mm");
  const [result, setResult] = useState({ text: "", is_problem: false });
  useEffect(() => {
    let is_wanted = true;
    const tell = (text: string, is_problem = false): void => void (is_wanted && setResult({ text, is_problem }));
    /** Read the chosen file; one that is too large is refused by its size, before a byte of it is read. */
    const read = async ({ name, size }: File): Promise<void> => {
      const problem = fileProblem(name, size);
      if (problem !== null) return tell(t(`world.file.${problem.key}`, problem.values), true);
      tell(t("world.file.reading", { name }));
      try {
        const scale_m = name.toLowerCase().endsWith(".dae") ? 1 : (FILE_UNITS[unit] ?? 1);
        const { vertices, triangles, deviation_m } = makeMesh(await readCorners(name, await (file as File).arrayBuffer()), scale_m);
        if (!is_wanted) return;
        take({ name: objectName(name), shape: meshShape(vertices, triangles) });
        const { units } = store.state.settings;
        const values = { name, count: triangles.length, size: sizeText(vertices, units), deviation: distanceText(deviation_m, units) };
        tell(t(deviation_m > 0 ? "world.file.simplified" : "world.file.ready", values));
      } catch (error) {
        tell(t("world.file.broken", { name, reason: (error as Error).message }), true);
      }
    };
    take(null);
    if (file === null) tell("");
    else void read(file);
    return () => void (is_wanted = false);
  }, [file, unit]);
  return (
    <div hidden={hidden}>
      <input type="file" data-testid="mesh-file" aria-label={t("world.file")} accept={MESH_KINDS.map((kind) => `.${kind}`).join()} onChange={({ currentTarget }) => setFile(currentTarget.files?.[0] ?? null)} />
      <Line text={t("world.file.unit")}><Select testid="mesh-unit" label={t("world.file.unit")} value={unit} options={Object.keys(FILE_UNITS).map((each) => [each, each])} take={setUnit} /></Line>
      <small class="hint">{t("world.file.limit", { limit: MAX_FILE_BYTES / 1e6 })}</small>
      <p class="hint" data-testid="mesh-result" role="status" data-off={String(result.is_problem)}>{result.text}</p>
    </div>
  );
}

function objectName(file_name: string): string {
  return file_name.replace(/\.[^.]*$/, "").replace(/[^\p{L}\p{N}_-]+/gu, "_").slice(0, 40) || "mesh";
}

function sizeText(vertices: Shape["vertices"], units: UnitSystem): string {
  // The mesh is about its middle.
  const sizes = [0, 1, 2].map((axis) => 2 * vertices.reduce((most, vertex) => Math.max(most, vertex[axis] ?? 0), 0));
  return sizes.map((size_m) => distanceText(size_m, units)).join(" × ");
}
