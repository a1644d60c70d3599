import { planningGroup } from "../logic/robot-info";
import { undoing, withChange } from "../logic/scene-history";
import { duplicateOf, placedOn } from "../logic/scene-objects";
import type { Color, Orientation, Point, SceneChange, SceneObject, State } from "../state/state";
import { onConnect, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { ask, askNames, type Connection } from "./connection";
import type { TriggerResponse } from "./messages";
import {
  addObject, attachObject, detachObject, differenceMessage, moveObject, readSceneText, removeObject, sceneDiff, sceneText,
  type SceneDiff, type SceneFile,
} from "./planning-scene";

const APPLY = "/apply_planning_scene";

/** Time for an answer [s]: the largest mesh has 6 MB as text, and is checked. */
const APPLY_TIMEOUT_S = 20;

/** Parts of a scene that a file has: attached objects, geometry, colours (moveit_msgs/PlanningSceneComponents). */
const FILE_COMPONENTS = 4 + 16 + 512;

/** Changes of the planning scene by the user, each of which can be undone; refusals are told in the server's words. */
export class SceneEditor {
  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    store.subscribe(
      ({ editing }) => editing.clicked,
      (clicked, { editing: { placing }, objects }) => {
        if (clicked === null || placing === null) return;
        this.edit({ placing: null, clicked: null });
        void this.add(placedOn(placing, clicked, objects));
      },
    );
    onConnect(store, () => void this.listSaved());
  }

  async add(object: SceneObject): Promise<boolean> {
    const done = await this.change([object.id], { world: [addObject(object)], colors: colorOf(object) });
    if (done) this.store.set({ selected_object: object.id });
    return done;
  }

  async move(id: string, position_m: Point, orientation: Orientation): Promise<void> {
    await this.change([id], { world: [moveObject(id, position_m, orientation)] });
  }

  async rename(object: SceneObject, name: string): Promise<void> {
    const renamed = { ...object, id: name };
    const world = [removeObject(object.id), addObject(renamed)];
    const done = await this.change([object.id, name], { world, colors: colorOf(renamed) });
    if (done) this.store.set({ selected_object: name });
  }

  async duplicate(object: SceneObject): Promise<void> {
    await this.add(duplicateOf(object, this.store.state.objects));
  }

  async paint(id: string, color: Color): Promise<void> {
    await this.change([id], { colors: { [id]: color } });
  }

  async remove({ id, attached }: SceneObject): Promise<void> {
    await this.change([id], { attached: attached ? [detachObject(id)] : [], world: [removeObject(id)] });
  }

  async attach(id: string): Promise<void> {
    const group = planningGroup(this.store.state);
    if (group?.tip) await this.change([id], { attached: [attachObject(id, group.tip, group.touch_links)] });
  }

  async detach(id: string): Promise<void> {
    await this.change([id], { attached: [detachObject(id)] });
  }

  async undo(): Promise<void> {
    const { editing, objects } = this.store.state;
    const last = editing.history.at(-1);
    if (last === undefined) return;
    if (await this.apply(sceneDiff(differenceMessage(undoing(last, objects))))) {
      this.edit({ history: editing.history.filter((change) => change !== last) });
    }
  }

  async listSaved(): Promise<void> {
    this.edit({ saved: await askNames(this.connection, "/arm/scenes/list") });
  }

  async scenes(work: "save" | "load" | "delete", name: string): Promise<boolean> {
    const objects = this.store.state.objects;
    const { success, message } = await ask<TriggerResponse>(this.connection, `/arm/scenes/${work}`, { name }, APPLY_TIMEOUT_S);
    this.edit({ result: message });
    if (success && work === "load") this.remember({ objects, ids: null });
    await this.listSaved();
    return success;
  }

  /** Return the present scene as the text of a file; null when the server does not tell it. */
  async fileText(): Promise<string | null> {
    let text: string | null = null;
    await this.attempt(async () => {
      const request = { components: { components: FILE_COMPONENTS } };
      const { scene } = await this.connection.call<{ scene: SceneFile }>("/get_planning_scene", request, APPLY_TIMEOUT_S);
      text = sceneText(scene);
      return true;
    });
    return text;
  }

  async loadFile(text: string, name: string): Promise<void> {
    const scene = readSceneText(text);
    if (scene === null) return this.edit({ result: t("world.file.none", { name }) });
    const objects = this.store.state.objects;
    if (await this.apply(scene)) this.remember({ objects, ids: null });
  }

  edit(patch: Partial<State["editing"]>): void {
    this.store.patch("editing", patch);
  }

  private async change(ids: string[], diff: SceneDiff): Promise<boolean> {
    const { objects } = this.store.state;
    const done = await this.apply(sceneDiff(diff));
    if (done) this.remember({ objects, ids });
    return done;
  }

  private remember(change: SceneChange): void {
    this.edit({ history: withChange(this.store.state.editing.history, change) });
  }

  private apply(scene: object): Promise<boolean> {
    return this.attempt(async () => {
      const { success, refusal } = await this.connection.call<{ success: boolean }>(APPLY, { scene }, APPLY_TIMEOUT_S);
      this.edit({ result: success ? "" : refusal });
      return success;
    });
  }

  private async attempt(work: () => Promise<boolean>): Promise<boolean> {
    try {
      return await work();
    } catch (error) {
      this.edit({ result: (error as Error).message });
      return false;
    }
  }
}

function colorOf({ id, color }: SceneObject): Record<string, Color> {
  return color === null ? {} : { [id]: color };
}
