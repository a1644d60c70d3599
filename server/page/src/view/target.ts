import { Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import type { Point, State } from "../state/state";
import type { Ghost } from "./ghost";
import type { PageStore, Part } from "./part";
import type { Theme } from "./theme";
import type { Viewer } from "./viewer";

const BALL_RADIUS_M = 0.007;
// Of the size that three gives the arrows; larger ones hide the gripper.
const ARROWS_SIZE = 0.7;

/** The point that the user drags by three arrows; at rest it is where the tool is, or where it will be. */
export class Target implements Part {
  private readonly ball: Mesh<SphereGeometry, MeshBasicMaterial>;
  private readonly arrows: TransformControls;
  private moved = false;

  /**
   * @param viewer - shows it; the camera holds still while it is dragged.
   * @param canvas - where it is dragged.
   * @param store - told of the dragged position.
   * @param ghost - where the tool will be.
   */
  constructor(
    private readonly viewer: Viewer,
    canvas: HTMLCanvasElement,
    private readonly store: PageStore,
    private readonly ghost: Ghost,
  ) {
    this.ball = new Mesh(new SphereGeometry(BALL_RADIUS_M, 16, 12), new MeshBasicMaterial());
    this.arrows = new TransformControls(viewer.camera, canvas);
    this.arrows.setSize(ARROWS_SIZE);
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

  /** Takes other colours. */
  setTheme(theme: Theme): void {
    this.ball.material.color.set(theme.ghost);
  }

  private place(state: State): Point | null {
    if (state.wish.kind === "target" && state.target.position_m !== null) return state.target.position_m;
    return this.ghost.tool_m ?? state.tool_m;
  }

  private drag(dragging: boolean): void {
    this.viewer.orbit.enabled = !dragging;
    if (dragging) this.moved = false;
    this.store.patch("target", { dragging });
    // The last position of a drag is asked for once more, whatever was on its way.
    if (!dragging && this.moved) this.dragged();
  }

  private dragged(): void {
    const { target, plan } = this.store.state;
    this.moved = true;
    this.store.set({
      target: { ...target, position_m: this.ball.position.toArray() },
      wish: { kind: "target", joints_rad: null },
      plan: plan.trajectory === null ? plan : { trajectory: null, tool_path: [], scrub_s: null },
    });
  }
}
