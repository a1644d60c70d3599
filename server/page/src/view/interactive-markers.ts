import { Mesh, MeshBasicMaterial, SphereGeometry, type Object3D } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import { takesOrientation } from "../logic/joints";
import { denialReason } from "../logic/permissions";
import type { Orientation, Point, State } from "../state/state";
import { selectTarget, type PageStore } from "../state/store";
import type { Theme } from "./appearance";
import type { Ghost } from "./plan-preview";
import type { SceneObjects } from "./scene-objects";
import type { SceneComponent, Viewer } from "./viewer";

const BALL_RADIUS_M = 0.007;
// Fraction of three's default size; larger arrows hide the gripper.
const TARGET_ARROWS_SIZE = 0.7;

/** Marker of the target, dragged by three arrows; without a target it is at the tool of the ghost or the arm. */
export class TargetMarker implements SceneComponent {
  private readonly ball: Mesh<SphereGeometry, MeshBasicMaterial>;
  private readonly arrows: TransformControls;
  private moved = false;

  /**
   * @param viewer - viewer of the scene; its camera is locked during a drag.
   * @param canvas - canvas with the pointer events.
   * @param store - updated with the dragged position.
   * @param ghost - ghost with the future position of the tool.
   */
  constructor(
    private readonly viewer: Viewer,
    canvas: HTMLCanvasElement,
    private readonly store: PageStore,
    private readonly ghost: Ghost,
  ) {
    this.ball = new Mesh(new SphereGeometry(BALL_RADIUS_M, 16, 12), new MeshBasicMaterial());
    this.arrows = new TransformControls(viewer.camera, canvas);
    this.arrows.setSize(TARGET_ARROWS_SIZE);
    this.arrows.attach(this.ball);
    this.arrows.addEventListener("change", () => viewer.request());
    this.arrows.addEventListener("objectChange", () => this.dragged());
    this.arrows.addEventListener("dragging-changed", (event) => this.drag(event.value === true));
    viewer.scene.add(this.ball, this.arrows.getHelper());
  }

  update(state: State): void {
    const at = this.place(state);
    const shown = at !== null && at.every(Number.isFinite);
    this.ball.visible = shown;
    this.arrows.enabled = shown;
    this.arrows.getHelper().visible = shown;
    if (shown && !this.arrows.dragging) this.ball.position.set(...at);
  }

  /** Apply other colours. */
  setTheme(theme: Theme): void {
    this.ball.material.color.set(theme.ghost);
  }

  private place(state: State): Point | null {
    if (state.selection.kind === "target" && state.target.position_m !== null) return state.target.position_m;
    return this.ghost.tool_m ?? state.tool_m;
  }

  private drag(dragging: boolean): void {
    this.viewer.orbit.enabled = !dragging;
    if (dragging) this.moved = false;
    this.store.patch("target", { dragging });
    // Check the last position of a drag once more, as answers during the drag may be of earlier ones.
    if (!dragging && this.moved) this.dragged();
  }

  private dragged(): void {
    const { selection, target, tool_orientation } = this.store.state;
    this.moved = true;
    const orientation = selection.kind === "target" ? target.orientation : tool_orientation;
    selectTarget(this.store, this.ball.position.toArray(), takesOrientation(this.store.state) ? orientation : null);
  }
}

// Movement of a finger during a tap.
const TAP_PX = 5;
const OBJECT_ARROWS_SIZE = 0.6;

/** Callback with the pose that an object was dragged to, in the root link's frame. */
export type ObjectMoved = (id: string, position_m: Point, orientation: Orientation) => void;

/** Selection of an object of the planning scene by a tap, and its drag by three arrows. */
export class ObjectMarkers implements SceneComponent {
  // Created with the first selection, as that delays the first picture of the arm otherwise.
  private arrows: TransformControls | null = null;
  private attached: Object3D | null = null;
  private pressed: [number, number] = [0, 0];

  /**
   * @param viewer - viewer of the scene; its camera is locked during a drag.
   * @param canvas - canvas with the pointer events.
   * @param store - updated with the selected object.
   * @param objects - objects that can be selected.
   * @param moved - called with the pose that an object was dragged to.
   */
  constructor(
    private readonly viewer: Viewer,
    private readonly canvas: HTMLCanvasElement,
    private readonly store: PageStore,
    private readonly objects: SceneObjects,
    private readonly moved: ObjectMoved,
  ) {
    canvas.addEventListener("pointerdown", (event) => (this.pressed = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => this.tapped(event));
  }

  update(state: State): void {
    const is_allowed = denialReason("work", state) === "";
    const groups = is_allowed ? this.objects.worldObjects() : [];
    const selected = groups.find((group) => group.name === state.selected_object) ?? null;
    if (selected === this.attached || this.arrows?.dragging) return;
    if (selected === null) this.detach();
    else this.attach(selected);
  }

  private tapped(event: PointerEvent): void {
    const [x, y] = this.pressed;
    if (Math.hypot(event.clientX - x, event.clientY - y) > TAP_PX || (this.arrows?.axis ?? null) !== null) return;
    const hit = this.viewer.pick(event, this.objects.worldObjects());
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

  private attach(object: Object3D): void {
    this.attached = object;
    this.arrows ??= this.createArrows();
    this.arrows.attach(object);
    this.arrows.enabled = true;
  }

  private createArrows(): TransformControls {
    const arrows = new TransformControls(this.viewer.camera, this.canvas);
    arrows.setSize(OBJECT_ARROWS_SIZE);
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
