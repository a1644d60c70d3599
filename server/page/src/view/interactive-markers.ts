import * as THREE from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import { isOneArm, takesOrientation } from "../logic/joints";
import { isOpen } from "../logic/layout";
import { denialReason } from "../logic/permissions";
import { gripperClearance_m, HANDLE_END, HANDLE_START, handleLength_m } from "../logic/target-marker";
import type { Orientation, Point, State } from "../state/state";
import { selectTarget, type PageStore } from "../state/store";
import type { Theme } from "./appearance";
import type { Ghost } from "./plan-preview";
import type { Robot } from "./robot";
import type { RobotModel } from "./robot-model";
import type { SceneObjects } from "./scene-objects";
import type { SceneComponent, Viewer } from "./viewer";

// Soft ball that is grabbed, and its opacity.
const BALL_RADIUS_M = 0.018;
const BALL_OPACITY = 0.45;
// Length of an arrow of TransformControls of size 1, as a share of the picture's height at its distance (three's
// factor 1.9 / 4 of the half height, and arrows that end at 0.6).
const ARROW_SHARE = (1.9 / 8) * 0.6;

// Axes of three's handles.
const AXES = ["X", "Y", "Z"] as const;
const ARROWS_END = 0.6;
const SHAFT_RADIUS = 0.006;
const HEAD_RADIUS = 0.032;
const HEAD_LENGTH = 0.1;
// A finger meets what is this wide.
const GRIP_RADIUS = 0.11;
const GRIP_FROM = 0.75;

/** Form a ball that moves in the plane of the picture, and arrows that begin beside it; return the materials of the arrows. */
function offsetHandles(controls: TransformControls): THREE.Material[] {
  const materials: THREE.Material[] = [];
  const start = (HANDLE_START / HANDLE_END) * ARROWS_END;
  controls.getHelper().traverse((node) => {
    const axis = AXES.indexOf(node.name as (typeof AXES)[number]);
    const part = node instanceof THREE.Mesh ? partOfTranslation(node) : null;
    if (!(node instanceof THREE.Mesh) || part === null) return;
    node.geometry.dispose();
    // The planes would cover the gripper; the ball is drawn by the marker.
    if (axis < 0) node.geometry = node.name === "XYZ" && part === "grip" ? new THREE.SphereGeometry(start * GRIP_FROM, 12, 8) : new THREE.BufferGeometry();
    if (axis < 0) return;
    const is_first = node.parent?.children.find((other) => other.name === node.name) === node;
    node.geometry = !is_first ? new THREE.BufferGeometry() : part === "grip" ? grip(start) : arrow(start);
    if (part === "arrow") materials.push(node.material as THREE.Material);
    // The form points along y.
    if (axis === 0) node.geometry.rotateZ(-Math.PI / 2);
    if (axis === 2) node.geometry.rotateX(Math.PI / 2);
  });
  return materials;
}

/** Return which part of a handle that moves a mesh is; null for those that turn and scale, which have the same names. */
function partOfTranslation(node: THREE.Mesh): "arrow" | "grip" | null {
  const group = node.parent;
  const gizmo = group?.parent as { gizmo?: Record<string, unknown>; picker?: Record<string, unknown> } | null | undefined;
  if (!group || !gizmo) return null;
  if (group === gizmo.gizmo?.translate) return "arrow";
  return group === gizmo.picker?.translate ? "grip" : null;
}

/** Create what the pointer meets of an arrow along y: a little longer, and nearer to the middle than what is seen. */
function grip(start: number): THREE.BufferGeometry {
  const [from, to] = [start * GRIP_FROM, ARROWS_END + GRIP_RADIUS / 2];
  return new THREE.CylinderGeometry(GRIP_RADIUS, GRIP_RADIUS, to - from, 8).translate(0, (from + to) / 2, 0);
}

function arrow(start: number): THREE.BufferGeometry {
  const length = ARROWS_END - start;
  const shaft = length - HEAD_LENGTH;
  const profile = [
    [0, 0],
    [SHAFT_RADIUS, 0],
    [SHAFT_RADIUS, shaft],
    [HEAD_RADIUS, shaft],
    [0, length],
  ].map(([x, y]) => new THREE.Vector2(x, y));
  return new THREE.LatheGeometry(profile, 12).translate(0, start, 0);
}

/** Create handles in the scene of a viewer, whose camera stands still while they are dragged. */
function createHandles(viewer: Viewer, canvas: HTMLCanvasElement, drag: (dragging: boolean) => void, moved: () => void): TransformControls {
  const handles = new TransformControls(viewer.camera, canvas);
  handles.addEventListener("change", () => viewer.request());
  handles.addEventListener("objectChange", moved);
  handles.addEventListener("dragging-changed", ({ value }) => {
    viewer.orbit.enabled = value !== true;
    drag(value === true);
  });
  viewer.scene.add(handles.getHelper());
  return handles;
}

/** Marker of the target, dragged by its ball or by three arrows; without a target it is at the tool of the ghost or the arm. */
export class TargetMarker implements SceneComponent {
  private readonly ball: THREE.Mesh<THREE.SphereGeometry, THREE.MeshBasicMaterial>;
  // Made after the first picture, which they would delay.
  private arrows: TransformControls | null = null;
  private arrow_materials: readonly THREE.Material[] = [];
  private readonly has_hover = matchMedia("(hover: hover)");
  private moved = false;
  private measured: RobotModel | null = null;
  private clearance_m = 0;

  constructor(
    private readonly viewer: Viewer,
    private readonly canvas: HTMLCanvasElement,
    private readonly store: PageStore,
    private readonly ghost: Ghost,
    private readonly robot: Robot,
  ) {
    const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: BALL_OPACITY, depthTest: false });
    this.ball = new THREE.Mesh(new THREE.SphereGeometry(BALL_RADIUS_M, 20, 14), material);
  }

  update(state: State): void {
    if (!state.drawn) return;
    if (this.arrows === null) {
      this.arrows = createHandles(this.viewer, this.canvas, (dragging) => this.drag(dragging), () => this.dragged());
      this.arrow_materials = offsetHandles(this.arrows.attach(this.ball));
      this.viewer.scene.add(this.ball);
    }
    const at = this.place(state);
    const shown = at !== null && at.every(Number.isFinite) && isOpen(state.layout, "move");
    // A finger has no hover that could bring them.
    for (const material of this.arrow_materials) material.visible = this.isInHand() || !this.has_hover.matches;
    this.ball.visible = shown;
    this.arrows.enabled = shown;
    this.arrows.getHelper().visible = shown;
    if (shown && !this.arrows.dragging) this.ball.position.set(...at);
    if (shown) this.fitHandles(this.arrows);
  }

  /** Return true while the target is dragged, or an arrow is under the pointer. */
  isInHand(): boolean {
    return this.arrows !== null && (this.arrows.dragging || this.arrows.axis !== null);
  }

  private fitHandles(arrows: TransformControls): void {
    const { arm, tip } = this.robot;
    if (arm !== this.measured) {
      this.measured = arm;
      this.clearance_m = arm === null ? 0 : gripperClearance_m(arm.endSizes_m(tip));
    }
    const { camera } = this.viewer;
    const distance_m = camera.position.distanceTo(this.ball.position);
    const picture_m = 2 * distance_m * Math.tan((camera.fov * Math.PI) / 360);
    arrows.setSize(handleLength_m(this.clearance_m, picture_m) / (ARROW_SHARE * picture_m));
  }

  setTheme(theme: Theme): void {
    this.ball.material.color.set(theme.ghost);
  }

  private place(state: State): Point | null {
    if (!isOneArm(state)) return null;
    if (state.selection.kind === "target" && state.target.position_m !== null) return state.target.position_m;
    return this.ghost.tool_m ?? state.tool_m;
  }

  private drag(dragging: boolean): void {
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

export type ObjectMoved = (id: string, position_m: Point, orientation: Orientation) => void;

/** Tap on an object of the planning scene, which selects it, or on the place of a new one; drag of it by arrows. */
export class ObjectMarkers implements SceneComponent {
  // Created with the first selection, as that delays the first picture of the arm otherwise.
  private arrows: TransformControls | null = null;
  private attached: THREE.Object3D | null = null;
  private pressed: [number, number] = [0, 0];
  /** True once the present drag has moved or turned the object. */
  private is_moved = false;

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
    this.canvas.style.cursor = state.editing.placing === null ? "" : "crosshair";
    this.arrows?.setMode(state.editing.arrows);
    const is_allowed = denialReason("work", state) === "";
    // While an object is being placed, the arrows would take the click on what they stand on.
    const groups = is_allowed && state.editing.placing === null ? this.objects.worldObjects() : [];
    const selected = groups.find((group) => group.name === state.selected_object) ?? null;
    if (selected === this.attached || this.arrows?.dragging) return;
    if (selected === null) this.detach();
    else this.attach(selected);
  }

  private tapped(event: PointerEvent): void {
    const [x, y] = this.pressed;
    if (Math.hypot(event.clientX - x, event.clientY - y) > TAP_PX) return;
    if (this.store.state.editing.placing !== null) {
      const clicked = this.viewer.surfaceAt(event, this.objects.worldObjects());
      if (clicked !== null) this.store.patch("editing", { clicked });
      return;
    }
    if ((this.arrows?.axis ?? null) !== null) return;
    const hit = this.viewer.pick(event, this.objects.worldObjects());
    if ((hit?.name ?? null) !== this.store.state.selected_object) {
      this.store.set({ selected_object: hit?.name ?? null });
    }
  }

  private drag(dragging: boolean): void {
    if (dragging) this.is_moved = false;
    // A tap on an arrow is no change that could be undone.
    if (dragging || !this.is_moved || this.attached === null) return;
    const { name, position, quaternion } = this.attached;
    const { x, y, z, w } = quaternion;
    this.moved(name, position.toArray(), [x, y, z, w]);
  }

  private attach(object: THREE.Object3D): void {
    this.attached = object;
    this.arrows ??= createHandles(this.viewer, this.canvas, (dragging) => this.drag(dragging), () => void (this.is_moved = true));
    this.arrows.setSize(OBJECT_ARROWS_SIZE);
    this.arrows.setMode(this.store.state.editing.arrows);
    this.arrows.attach(object);
    this.arrows.enabled = true;
  }

  private detach(): void {
    this.attached = null;
    if (this.arrows === null) return;
    this.arrows.detach();
    this.arrows.enabled = false;
  }
}
