import type { Group, Object3D } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import { hindrance } from "../logic/rights";
import type { Point, State } from "../state/state";
import type { PageStore, Part } from "./part";
import type { SceneObjects } from "./scene-objects";
import type { Viewer } from "./viewer";

// A finger trembles by this much when it taps.
const TAP_PX = 5;
const ARROWS_SIZE = 0.6;

/** Told where a thing of the planning scene was dragged to, in the root link's frame. */
export type Moved = (id: string, position_m: Point, orientation: [number, number, number, number]) => void;

/** Things of the planning scene are chosen by a tap and dragged by three arrows. */
export class ObjectDrag implements Part {
  // Made when the first thing is chosen: they cost some of the time until the arm is seen.
  private arrows: TransformControls | null = null;
  private attached: Object3D | null = null;
  private pressed: [number, number] = [0, 0];

  /**
   * @param viewer - shows it; the camera holds still while a thing is dragged.
   * @param canvas - where it is dragged.
   * @param store - holds which thing is chosen.
   * @param objects - what can be chosen.
   * @param moved - told where a thing was dragged to.
   */
  constructor(
    private readonly viewer: Viewer,
    private readonly canvas: HTMLCanvasElement,
    private readonly store: PageStore,
    private readonly objects: SceneObjects,
    private readonly moved: Moved,
  ) {
    canvas.addEventListener("pointerdown", (event) => (this.pressed = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => this.tapped(event));
  }

  update(state: State): void {
    const may = hindrance("work", state) === "";
    const chosen = (may && this.standing().find((group) => group.name === state.selected_object)) || null;
    if (chosen === this.attached || this.arrows?.dragging) return;
    if (chosen === null) this.detach();
    else this.attach(chosen);
  }

  private standing(): Group[] {
    return this.objects.standing();
  }

  private tapped(event: PointerEvent): void {
    const [x, y] = this.pressed;
    if (Math.hypot(event.clientX - x, event.clientY - y) > TAP_PX || (this.arrows?.axis ?? null) !== null) return;
    const hit = this.viewer.pick(event, this.standing());
    if ((hit?.name ?? null) !== this.store.state.selected_object) {
      this.store.set({ selected_object: hit?.name ?? null });
    }
  }

  private drag(dragging: boolean): void {
    this.viewer.orbit.enabled = !dragging;
    if (dragging || this.attached === null) return;
    const { name, position, quaternion } = this.attached;
    const { x, y, z, w } = quaternion;
    this.moved(name, position.toArray(), [x, y, z, w]);
  }

  private attach(thing: Object3D): void {
    this.attached = thing;
    this.arrows ??= this.makeArrows();
    this.arrows.attach(thing);
    this.arrows.enabled = true;
  }

  private makeArrows(): TransformControls {
    const arrows = new TransformControls(this.viewer.camera, this.canvas);
    arrows.setSize(ARROWS_SIZE);
    arrows.addEventListener("change", () => this.viewer.request());
    arrows.addEventListener("dragging-changed", (event) => this.drag(event.value === true));
    this.viewer.scene.add(arrows.getHelper());
    return arrows;
  }

  private detach(): void {
    this.attached = null;
    if (this.arrows === null) return;
    this.arrows.detach();
    this.arrows.enabled = false;
  }
}
