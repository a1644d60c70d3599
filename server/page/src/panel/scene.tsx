import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { Color as ThreeColor, SRGBColorSpace } from "three";
import { AXES, quaternionOf, rollPitchYawOf, ROTATIONS, type RollPitchYaw } from "../logic/rotations";
import { planningGroup } from "../logic/robot-info";
import { MAX_NAME_LENGTH, MAX_PLACE_M, MAX_SIZE_M, MIN_SIZE_M, nameProblem, sizesOf, withSize } from "../logic/scene-objects";
import type { Color, Point, SceneObject } from "../state/state";
import { t } from "../texts/texts";
import { srgb } from "../view/flat-material";
import { Button, Gate, Line, MeasureField, MeasureLine, Radios, Section, TextField, Tick, usePage } from "./ui";

/** Colour of the field while an object has none of its own: that of the theme's objects. */
const THEME_COLOR = "#6f9a5c";

export function SceneBar(): JSX.Element {
  const { store, sceneEditor } = usePage();
  const { history, result } = store.state.editing;
  return (
    <div class="scene-bar">
      <Gate to="work"><div class="buttons"><Button testid="undo-scene" disabled={history.length === 0} press={() => void sceneEditor.undo()}>{t("world.undo")}</Button></div></Gate>
      <span data-testid="scene-result" role="status">{result}</span>
    </div>
  );
}

export function ObjectsSection(): JSX.Element {
  const { store } = usePage();
  const { objects, selected_object, collision_shapes } = store.state;
  const selected = objects.find(({ id }) => id === selected_object);
  return (
    <Section name="objects" title={t("world.objects")}>
      <Gate to="work">
        <p class="hint" data-testid="objects-empty" hidden={objects.length > 0}>{t("world.empty")}</p>
        <ul class="things" data-testid="objects">
          {objects.map(({ id, attached, frame }) => (
            <li key={id}>
              <Button testid={`object-${id}`} aria-pressed={id === selected_object} press={() => store.set({ selected_object: store.state.selected_object === id ? null : id })}>{id}</Button>
              <small class="hint">{attached ? t("world.held", { link: frame }) : ""}</small>
            </li>
          ))}
        </ul>
        <div data-testid="object-editor">{selected && <ObjectEditor key={selected.id} object={selected} />}</div>
      </Gate>
      <Tick testid="collision-shapes" checked={collision_shapes} take={(on) => store.set({ collision_shapes: on })} text={t("world.contacts")} />
    </Section>
  );
}

function ObjectEditor({ object }: { object: SceneObject }): JSX.Element {
  const { store, sceneEditor } = usePage();
  const { id, attached, color } = object;
  const link = planningGroup(store.state)?.tip ?? "";
  return (
    <div class="object-editor" role="group" aria-label={id}>
      <NameLine object={object} />
      {/* What is held moves with its link. */}
      {!attached && <Dimensions object={object} />}
      <Line text={t("world.color")}>
        <input type="color" data-testid="object-color" aria-label={t("world.color")} value={color === null ? THEME_COLOR : hexOf(color)} onChange={({ currentTarget }) => void sceneEditor.paint(id, [...srgb(currentTarget.value), 1])} />
      </Line>
      <div class="buttons">
        {attached
          ? <Button testid="detach-object" title={t("world.detach.hint")} press={() => void sceneEditor.detach(id)}>{t("world.detach")}</Button>
          : <Button testid="attach-object" title={t("world.attach.hint", { link })} disabled={link === ""} press={() => void sceneEditor.attach(id)}>{t("world.attach")}</Button>}
        {!attached && <Button testid="duplicate-object" press={() => void sceneEditor.duplicate(object)}>{t("world.duplicate")}</Button>}
        <Button testid={`remove-${id}`} press={() => void sceneEditor.remove(object)}>{t("world.remove")}</Button>
      </div>
    </div>
  );
}

function NameLine({ object }: { object: SceneObject }): JSX.Element {
  const { store, sceneEditor } = usePage();
  const { id } = object;
  const [problem, tell] = useState("");
  const rename = (wanted: string): void => {
    const reason = nameProblem(wanted, id, store.state.objects);
    tell(reason === "" ? "" : t(`world.name.${reason}`, { name: wanted, limit: MAX_NAME_LENGTH }));
    if (reason === "" && wanted !== id) void sceneEditor.rename(object, wanted);
  };
  return (
    <div>
      <Line text={t("world.name")}><TextField testid="object-name" value={id} take={rename} /></Line>
      <small class="problem" data-testid="object-name-problem" role="alert">{problem}</small>
    </div>
  );
}

function Dimensions({ object }: { object: SceneObject }): JSX.Element {
  const { store, sceneEditor } = usePage();
  const { id, shapes, position_m, orientation } = object;
  const [only] = shapes;
  const sizes = shapes.length === 1 && only ? sizesOf(only) : [];
  const turn = (index: number, angle_rad: number): void => {
    void sceneEditor.move(id, position_m, quaternionOf(rollPitchYawOf(orientation).with(index, angle_rad) as RollPitchYaw));
  };
  return (
    <>
      {sizes.length > 0 && (
        <MeasureLine title={t("world.size")}>
          {sizes.map(({ name }, index) => (
            <MeasureField
              key={name} testid={`object-size-${name}`} name={t(`world.size.${name}`)} label={`${t("world.size")} ${t(`world.size.${name}`)}`} lower={MIN_SIZE_M} upper={MAX_SIZE_M}
              value={only?.dimensions[index] ?? 0} take={(value) => void sceneEditor.add(withSize(object, index, value))}
            />
          ))}
        </MeasureLine>
      )}
      <MeasureLine title={t("world.middle")}>
        {AXES.map((axis, index) => (
          <MeasureField
            key={axis} testid={`object-${axis}`} name={axis} label={`${t("world.middle")} ${axis}`} lower={-MAX_PLACE_M} upper={MAX_PLACE_M}
            value={position_m[index] ?? 0} take={(value) => void sceneEditor.move(id, position_m.with(index, value) as Point, orientation)}
          />
        ))}
      </MeasureLine>
      <MeasureLine title={t("world.turn")}>
        {ROTATIONS.map(([name, limit], index) => (
          <MeasureField key={name} testid={`object-${name}`} kind="revolute" name={t(`world.${name}`)} lower={-limit} upper={limit} value={rollPitchYawOf(orientation)[index] ?? 0} take={(angle_rad) => turn(index, angle_rad)} />
        ))}
      </MeasureLine>
      <Radios
        testid="arrows" label={t("world.arrows")} value={store.state.editing.arrows} options={[["translate", t("world.arrows.translate")], ["rotate", t("world.arrows.rotate")]]}
        take={(arrows) => sceneEditor.edit({ arrows: arrows === "rotate" ? "rotate" : "translate" })} titled
      />
    </>
  );
}

function hexOf([red, green, blue]: Color): string {
  return `#${new ThreeColor().setRGB(red, green, blue, SRGBColorSpace).getHexString()}`;
}
