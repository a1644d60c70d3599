import { looksSame } from "../logic/joint-report";
import type { Joints, Point, State } from "../state/state";
import { Arm } from "./arm";
import { FrameCounter, type DrawStats } from "./frame-counter";
import { Ghost } from "./ghost";
import { Label } from "./label";
import { Materials } from "./materials";
import { notice } from "./notices";
import { ObjectDrag, type Moved } from "./object-drag";
import type { PageStore, Part } from "./part";
import { Robot } from "./robot";
import { SceneObjects } from "./scene-objects";
import { Surroundings } from "./surroundings";
import { Target } from "./target";
import { currentTheme, watchTheme } from "./theme";
import { ToolPath } from "./tool-path";
import { Viewer } from "./viewer";

/** The 3D view that was started. */
export interface View {
  /** Looks at the whole arm from where the page began. */
  resetCamera(): void;
  /** Draws at once, for pictures of the canvas. */
  draw(): void;
  /** Where a point of the root link's frame is seen, in pixels from the page's upper left corner. */
  screenOf(point_m: Point): [number, number];
  /** Figures of what was drawn. */
  stats(): DrawStats;
  /** Ends it. */
  dispose(): void;
}

/**
 * Starts the 3D view on a canvas.
 *
 * @param canvas - what is drawn on.
 * @param store - what is shown; the view writes the target, the tool's place and messages to it.
 * @param moved - told where a thing of the planning scene was dragged to.
 * @returns the view; null, with a message to the user, where the browser cannot draw in 3D.
 */
export function startView(canvas: HTMLCanvasElement, store: PageStore, moved: Moved = () => undefined): View | null {
  try {
    return new Drawing(canvas, store, moved);
  } catch (error) {
    const why = (error as Error).message;
    notice(store, "webgl", `The arm cannot be drawn in 3D here (${why}): it is not shown, everything else works.`);
    return null;
  }
}

class Drawing implements View {
  private readonly viewer: Viewer;
  private readonly robot: Robot;
  private readonly target: Target;
  private readonly label: Label;
  private readonly surroundings: Surroundings;
  private readonly materials = new Materials(currentTheme());
  private readonly counter = new FrameCounter();
  private readonly parts: Part[];
  private readonly endings: (() => void)[];
  private shown_joints: Joints | null = null;

  constructor(
    given: HTMLCanvasElement,
    private readonly store: PageStore,
    moved: Moved,
  ) {
    const viewer = new Viewer(given, () => this.prepare(), () => this.drawn());
    const { scene, canvas } = viewer;
    const { materials } = this;
    this.viewer = viewer;
    this.label = new Label(canvas, viewer.camera);
    this.robot = new Robot(scene, store, materials, currentTheme, (another) => this.robotChanged(another));
    const ghost = new Ghost(this.robot, materials, this.label);
    this.target = new Target(viewer, canvas, store, ghost);
    const objects = new SceneObjects(scene, this.robot, store, materials);
    const path = new ToolPath(scene, this.robot, store, materials);
    const drag = new ObjectDrag(viewer, canvas, store, objects, moved);
    this.parts = [this.robot, new Arm(this.robot, store, materials), path, ghost, this.target, objects, drag];
    this.surroundings = new Surroundings(scene);
    this.takeTheme();
    this.watchGraphics(canvas);
    canvas.addEventListener("dblclick", () => this.resetCamera());
    this.endings = [watchTheme(() => this.takeTheme()), ...this.watch()];
  }

  resetCamera(): void {
    if (this.robot.arm !== null) this.viewer.frame(this.robot.arm.robot);
  }

  draw(): void {
    this.viewer.draw();
  }

  screenOf(point_m: Point): [number, number] {
    return this.viewer.screenOf(point_m);
  }

  stats(): DrawStats {
    return this.counter.read();
  }

  dispose(): void {
    for (const end of this.endings) end();
    this.viewer.dispose();
  }

  private watch(): (() => void)[] {
    const { store } = this;
    const shown: ((state: State) => unknown)[] = [
      (state) => state.urdf,
      (state) => state.srdf,
      (state) => state.plan,
      (state) => state.target,
      (state) => state.wish,
      (state) => state.objects,
      (state) => state.selected_object,
      (state) => state.identity,
      (state) => state.collision_shapes,
    ];
    return [
      store.subscribe((state) => state.joints, (joints) => this.jointsCame(joints)),
      ...shown.map((selector) => store.subscribe(selector, () => this.viewer.request())),
    ];
  }

  private watchGraphics(canvas: HTMLCanvasElement): void {
    const text = "The browser has taken the graphics away (a phone does so while it sleeps): the arm is not drawn.";
    canvas.addEventListener("webglcontextlost", () => notice(this.store, "graphics", text));
    canvas.addEventListener("webglcontextrestored", () => notice(this.store, "graphics", ""));
  }

  private jointsCame(joints: Joints): void {
    if (this.shown_joints !== null && looksSame(joints, this.shown_joints)) {
      this.counter.cameAsDrawn(joints.stamp);
      return;
    }
    this.counter.came(joints.stamp);
    this.viewer.request();
  }

  private prepare(): void {
    this.counter.begin();
    for (const part of this.parts) part.update(this.store.state);
    this.label.place();
  }

  private drawn(): void {
    this.shown_joints = this.store.state.joints;
    this.counter.drawn(this.robot.arm !== null);
  }

  private robotChanged(another: boolean): void {
    if (another) this.resetCamera();
    this.viewer.request();
  }

  private takeTheme(): void {
    const theme = currentTheme();
    this.materials.setTheme(theme);
    this.surroundings.setTheme(theme);
    this.target.setTheme(theme);
    this.viewer.request();
  }
}
