import type { WebGLRenderer } from "three";
import { looksEqual } from "../logic/joints";
import type { Joints, State } from "../state/state";
import { setNotice, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { currentTheme, Environment, Materials, watchTheme } from "./appearance";
import { ObjectMarkers, TargetMarker, type ObjectMoved } from "./interactive-markers";
import { Ghost, Label, ToolPath } from "./plan-preview";
import { ReachableRegion } from "./reachable-region";
import { ReachHint } from "./reach-hint";
import { JointStateDisplay, Robot } from "./robot";
import type { RobotModel } from "./robot-model";
import { SceneObjects } from "./scene-objects";
import { SweptRange } from "./swept-range";
import { Thumbnails } from "./thumbnails";
import { Viewer, type SceneComponent } from "./viewer";

export interface FrameFigures {
  frames: number;
  /** Time of the first frame with the arm, from the page's start; 0 before. */
  arm_ms: number;
  /** Stamp of the joint state that is on the screen. */
  joint_stamp_s: number;
  /** Time from the newest message of /joint_states to the end of the frame that draws it. */
  age_ms: number;
}

export const NO_FRAMES: FrameFigures = { frames: 0, arm_ms: 0, joint_stamp_s: 0, age_ms: 0 };

// Three passes of the graphics, which in software take as long as the arm itself; the shadow may come a little behind.
const SHADOW_PERIOD_MS = 100;

// Parts of the state that the view draws, beside the joints.
const DRAWN: readonly (keyof State)[] = [
  "urdf", "robot", "group", "plan", "target", "selection", "objects", "selected_object", "editing", "region", "identity",
  "layout", "sequence", "classroom", "collision_shapes", "commissioning", "joint_in_hand", "drawn",
];

/** Start the 3D view on a canvas; null, with a notice to the user, where the browser cannot draw in 3D. */
export function startView(canvas: HTMLCanvasElement, store: PageStore, moved: ObjectMoved): SceneView | null {
  try {
    return new SceneView(canvas, store, moved);
  } catch (error) {
    setNotice(store, "view:webgl", t("picture.no_3d", { reason: (error as Error).message }));
    store.set({ drawn: true });
    return null;
  }
}

export class SceneView {
  readonly viewer: Viewer;
  private readonly robot: Robot;
  private readonly target: TargetMarker;
  private readonly reach: ReachHint;
  private readonly label: Label;
  private readonly environment: Environment;
  private readonly thumbnails: Thumbnails;
  private readonly materials = new Materials(currentTheme());
  readonly figures: FrameFigures = { ...NO_FRAMES };
  /** Time at which the newest joint state came that is not drawn yet; null without one. */
  private received_ms: number | null = null;
  private readonly components: SceneComponent[];
  private shown_joints: Joints | null = null;
  private shadow_of: [Joints, RobotModel, number] | null = null;
  private meshes_loaded = 0;
  private shadow_ms = -Infinity;
  private shadow_timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    given: HTMLCanvasElement,
    private readonly store: PageStore,
    moved: ObjectMoved,
  ) {
    const viewer = new Viewer(given, (renderer) => this.prepare(renderer), () => this.drawn());
    const { scene, canvas } = viewer;
    const { materials } = this;
    this.viewer = viewer;
    this.label = new Label(canvas, viewer.camera);
    this.robot = new Robot(scene, store, materials, currentTheme, (is_new) => this.robotChanged(is_new));
    const ghost = new Ghost(this.robot, materials, this.label);
    this.target = new TargetMarker(viewer, canvas, store, ghost, this.robot);
    this.reach = new ReachHint(this.robot, () => this.target.isInHand());
    scene.add(this.reach.group);
    const objects = new SceneObjects(scene, this.robot, store, materials);
    const path = new ToolPath(scene, this.robot, store, materials);
    const markers = new ObjectMarkers(viewer, canvas, store, objects, moved);
    const arm = new JointStateDisplay(this.robot, store, materials);
    const swept = new SweptRange(this.robot, materials);
    const region = new ReachableRegion(scene);
    this.environment = new Environment(scene);
    this.thumbnails = new Thumbnails(viewer, this.robot, store, this.environment.sky);
    this.components = [this.robot, arm, path, ghost, this.target, objects, markers, swept, region];
    canvas.addEventListener("webglcontextlost", () => setNotice(store, "view:graphics", t("picture.lost")));
    canvas.addEventListener("webglcontextrestored", () => setNotice(store, "view:graphics", ""));
    canvas.addEventListener("dblclick", () => this.resetCamera());
    watchTheme(() => this.applyTheme());
    this.watchState();
  }

  private resetCamera(): void {
    if (this.robot.arm !== null) this.viewer.frame(this.robot.arm.robot);
  }

  private watchState(): void {
    const { store } = this;
    store.subscribe((state) => state.joints, (joints) => this.jointsReceived(joints));
    for (const part of DRAWN) store.subscribe((state) => state[part], () => this.viewer.request());
    store.subscribe((state) => state.settings.units, () => this.applyTheme());
    // The person compares the whole arm with the model, wherever the camera was.
    const compared = ({ commissioning }: State): string => {
      return commissioning?.procedure === "verify" ? `verify ${commissioning.step}` : "";
    };
    store.subscribe(compared, (step) => step !== "" && this.resetCamera());
  }

  private jointsReceived(joints: Joints): void {
    if (this.shown_joints !== null && looksEqual(joints, this.shown_joints)) {
      Object.assign(this.figures, { joint_stamp_s: joints.stamp, age_ms: 0 });
      return;
    }
    this.received_ms = performance.now();
    this.viewer.request();
  }

  private prepare(renderer: WebGLRenderer): void {
    for (const component of this.components) component.update(this.store.state);
    // The first picture does without the reach, for which hundreds of poses of the arm are computed.
    if (this.figures.arm_ms > 0) {
      this.reach.update(this.store.state);
      this.thumbnails.update(this.store.state);
    }
    this.label.place();
    this.castShadow(renderer);
  }

  private castShadow(renderer: WebGLRenderer): void {
    const { arm } = this.robot;
    if (arm === null || this.figures.arm_ms === 0) return;
    const { joints } = this.store.state;
    const inputs: [Joints, RobotModel, number] = [joints, arm, this.meshes_loaded];
    if (inputs.every((input, index) => input === this.shadow_of?.[index])) return;
    const wait_ms = this.shadow_ms + SHADOW_PERIOD_MS - performance.now();
    clearTimeout(this.shadow_timer);
    if (wait_ms > 0) {
      this.shadow_timer = setTimeout(() => this.viewer.request(), wait_ms);
      return;
    }
    this.shadow_ms = performance.now();
    this.shadow_of = inputs;
    this.environment.castShadow(renderer, arm.robot);
  }

  private drawn(): void {
    const { figures } = this;
    this.shown_joints = this.store.state.joints;
    figures.frames += 1;
    if (this.robot.arm === null) return;
    const now_ms = performance.now();
    if (figures.arm_ms === 0) {
      figures.arm_ms = now_ms;
      // The first picture does without the shadow, whose programs take long to compile in software.
      this.store.set({ drawn: true });
    }
    if (this.received_ms === null) return;
    Object.assign(figures, { joint_stamp_s: this.shown_joints.stamp, age_ms: now_ms - this.received_ms });
    this.received_ms = null;
  }

  private robotChanged(is_new: boolean): void {
    if (is_new) this.resetCamera();
    this.meshes_loaded += 1;
    this.thumbnails.reset();
    this.viewer.request();
  }

  private applyTheme(): void {
    const theme = currentTheme();
    this.materials.setTheme(theme);
    this.environment.setTheme(theme, this.store.state.settings.units);
    this.target.setTheme(theme);
    this.reach.setTheme(theme);
    this.viewer.request();
  }
}
