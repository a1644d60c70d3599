import type { WebGLRenderer } from "three";
import { looksEqual } from "../logic/joints";
import type { Joints, Point, State } from "../state/state";
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

/** Figures of the drawn frames. */
export interface FrameFigures {
  /** Frames since the start. */
  frames: number;
  /** Stamp of the joint state that is on the screen, in seconds. */
  drawn_stamp: number;
  /** Time from the newest message of /joint_states to the end of the frame that draws it. */
  age_ms: number;
  /** Time of the first frame with the arm, from the page's start; null before. */
  arm_drawn_ms: number | null;
}

// Three passes of the graphics, which in software take as long as the arm itself; the shadow may come a little behind.
const SHADOW_PERIOD_MS = 100;

/** Counter of frames, which also measures the age of each joint state on the screen. */
class FrameStatistics {
  readonly figures: FrameFigures = { frames: 0, drawn_stamp: 0, age_ms: 0, arm_drawn_ms: null };
  private received_ms: number | null = null;
  private stamp = 0;

  /** Note a message of /joint_states. */
  jointStateReceived(stamp: number): void {
    this.stamp = stamp;
    this.received_ms = performance.now();
  }

  /** Note a message of /joint_states that needs no new frame. */
  unchangedJointStateReceived(stamp: number): void {
    this.figures.drawn_stamp = stamp;
    this.figures.age_ms = 0;
  }

  /** Note a frame, with the arm or without. */
  frameDrawn(with_arm: boolean): void {
    const now_ms = performance.now();
    this.figures.frames += 1;
    if (with_arm) this.figures.arm_drawn_ms ??= now_ms;
    if (!with_arm || this.received_ms === null) return;
    this.figures.drawn_stamp = this.stamp;
    this.figures.age_ms = now_ms - this.received_ms;
    this.received_ms = null;
  }
}

/** Start the 3D view on a canvas; null, with a notice to the user, where the browser cannot draw in 3D. */
export function startView(canvas: HTMLCanvasElement, store: PageStore, moved: ObjectMoved): SceneView | null {
  try {
    return new SceneView(canvas, store, moved);
  } catch (error) {
    setNotice(store, "view:webgl", t("picture.no_3d", { reason: (error as Error).message }));
    return null;
  }
}

/** 3D view of the arm, its plan and the planning scene. */
export class SceneView {
  private readonly viewer: Viewer;
  private readonly robot: Robot;
  private readonly target: TargetMarker;
  private readonly reach: ReachHint;
  private readonly label: Label;
  private readonly environment: Environment;
  private readonly thumbnails: Thumbnails;
  private readonly materials = new Materials(currentTheme());
  private readonly statistics = new FrameStatistics();
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
    this.applyTheme();
    this.watchGraphics(canvas);
    canvas.addEventListener("dblclick", () => this.resetCamera());
    watchTheme(() => this.applyTheme());
    this.watchState();
  }

  /** Return the place of a point of the root link's frame, in pixels from the page's upper left corner. */
  screenOf(point_m: Point): [number, number] {
    return this.viewer.screenOf(point_m);
  }

  /** Figures of the drawn frames. */
  get figures(): Readonly<FrameFigures> {
    return this.statistics.figures;
  }

  private resetCamera(): void {
    if (this.robot.arm !== null) this.viewer.frame(this.robot.arm.robot);
  }

  private watchState(): void {
    const { store } = this;
    const shown: ((state: State) => unknown)[] = [
      (state) => state.urdf,
      (state) => state.robot,
      (state) => state.group,
      (state) => state.plan,
      (state) => state.target,
      (state) => state.selection,
      (state) => state.objects,
      (state) => state.selected_object,
      (state) => state.editing,
      (state) => state.region,
      (state) => state.identity,
      (state) => state.layout,
      (state) => state.sequence,
      (state) => state.classroom,
      (state) => state.collision_shapes,
      (state) => state.commissioning,
      (state) => state.joint_in_hand,
    ];
    store.subscribe((state) => state.joints, (joints) => this.jointsReceived(joints));
    for (const selector of shown) store.subscribe(selector, () => this.viewer.request());
    store.subscribe((state) => state.settings.units, () => this.applyTheme());
    // The person compares the whole arm with the model, wherever the camera was.
    const compared = ({ commissioning }: State): string => {
      return commissioning?.procedure === "verify" ? `verify ${commissioning.step}` : "";
    };
    store.subscribe(compared, (step) => step !== "" && this.resetCamera());
  }

  private watchGraphics(canvas: HTMLCanvasElement): void {
    canvas.addEventListener("webglcontextlost", () => setNotice(this.store, "view:graphics", t("picture.lost")));
    canvas.addEventListener("webglcontextrestored", () => setNotice(this.store, "view:graphics", ""));
  }

  private jointsReceived(joints: Joints): void {
    if (this.shown_joints !== null && looksEqual(joints, this.shown_joints)) {
      this.statistics.unchangedJointStateReceived(joints.stamp);
      return;
    }
    this.statistics.jointStateReceived(joints.stamp);
    this.viewer.request();
  }

  private prepare(renderer: WebGLRenderer): void {
    for (const component of this.components) component.update(this.store.state);
    // The first picture does without the reach, for which hundreds of poses of the arm are computed.
    if (this.figures.arm_drawn_ms !== null) {
      this.reach.update(this.store.state);
      this.thumbnails.update(this.store.state);
    }
    this.label.place();
    this.castShadow(renderer);
  }

  private castShadow(renderer: WebGLRenderer): void {
    const { arm } = this.robot;
    if (arm === null || this.figures.arm_drawn_ms === null) return;
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
    this.shown_joints = this.store.state.joints;
    // The first picture does without the shadow, whose programs take long to compile in software.
    if (this.robot.arm !== null && this.figures.arm_drawn_ms === null) this.viewer.request();
    this.statistics.frameDrawn(this.robot.arm !== null);
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
