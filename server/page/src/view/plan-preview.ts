import { CatmullRomCurve3, Mesh, TubeGeometry, Vector3, type Camera, type Scene } from "three";
import { jointReport } from "../logic/joints";
import { isOpen } from "../logic/layout";
import { distanceText } from "../logic/numbers";
import { ghostPose, samplePlan, sampleTimes_s, type GhostPose } from "../logic/trajectory";
import type { Plan, Point, State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Materials } from "./appearance";
import type { Robot } from "./robot";
import type { RobotModel } from "./robot-model";
import type { SceneComponent } from "./viewer";

// Offset that keeps the label clear of the marker's arrows.
const ASIDE_PX = 16;
const ABOVE_PX = 24;

export class Label {
  private readonly element = document.createElement("div");
  private anchor: Vector3 | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly camera: Camera,
  ) {
    this.element.className = "view-label";
    this.element.dataset.testid = "target-distance";
    this.element.setAttribute("role", "status");
    this.element.hidden = true;
    canvas.parentElement?.append(this.element);
  }

  show(text: string, at: Vector3): void {
    this.element.hidden = text === "";
    if (this.element.textContent !== text) this.element.textContent = text;
    this.anchor = text === "" ? null : at.clone();
    this.place();
  }

  /** Move the text to the present place of its point on the screen. */
  place(): void {
    if (this.anchor === null) return;
    const projected = this.anchor.clone().project(this.camera);
    const x_px = ((projected.x + 1) / 2) * this.canvas.clientWidth;
    const y_px = ((1 - projected.y) / 2) * this.canvas.clientHeight;
    const { parentElement: free } = this.element;
    if (free === null) return;
    // For a point outside of the free picture it stays at the edge, as it must not cover the panel.
    const x_inside_px = clamp(x_px + ASIDE_PX - free.offsetLeft, free.clientWidth - this.element.offsetWidth);
    const y_inside_px = clamp(y_px - ABOVE_PX - free.offsetTop, free.clientHeight - this.element.offsetHeight);
    this.element.style.transform = `translate(${Math.round(x_inside_px)}px, ${Math.round(y_inside_px)}px)`;
  }
}

function clamp(value: number, upper: number): number {
  return Math.max(0, Math.min(value, upper));
}

/** Translucent arm in its future pose: on the plan, or as near to the target as it gets. */
export class Ghost implements SceneComponent {
  tool_m: Point | null = null;
  private model: RobotModel | null = null;
  private arm: RobotModel | null = null;
  private shown: [unknown, unknown, unknown, unknown, unknown] | null = null;

  constructor(
    private readonly robot: Robot,
    private readonly materials: Materials,
    private readonly label: Label,
  ) {}

  update(state: State): void {
    if (this.robot.arm === null) return;
    if (this.robot.arm !== this.arm) this.drop();
    const pose = ghostPose(state);
    const inputs: NonNullable<typeof this.shown> = [state.plan, state.target, state.selection, state.joints, state.settings.units];
    // Joints outside of the goal are drawn at their measured position, so the ghost follows /joint_states too.
    if (this.shown?.every((input, index) => input === inputs[index])) return;
    this.shown = inputs;
    if (pose === null) this.hide();
    else this.show(pose, state);
  }

  private show(pose: GhostPose, state: State): void {
    this.model ??= this.robot.createModel("visual", () => this.materials.ghost);
    if (this.model === null) return;
    this.model.robot.visible = true;
    const goal = Object.entries(pose.joints_rad).filter(([, value]) => Number.isFinite(value));
    this.model.setJoints({ ...jointReport(state.joints, this.model.joint_names).values, ...Object.fromEntries(goal) });
    this.tool_m = this.model.linkPosition_m(this.robot.tip);
    this.materials.setOffTarget(pose.off_target_m !== null);
    const off = pose.off_target_m;
    const at = state.target.position_m ?? this.tool_m;
    const text = off === null || at === null ? "" : t("picture.off", { distance: distanceText(off, state.settings.units) });
    this.label.show(text, new Vector3(...(at ?? [0, 0, 0])));
  }

  private hide(): void {
    if (this.model !== null) this.model.robot.visible = false;
    this.tool_m = null;
    this.label.show("", new Vector3());
  }

  private drop(): void {
    this.arm = this.robot.arm;
    this.model?.dispose();
    this.model = null;
    this.shown = null;
  }
}

// On a path of half a metre the points are then 4 mm apart, and the curve looks smooth.
const SAMPLES = 120;
const MIN_SAMPLES = 12;
const RADIUS_M = 0.0015;
const SIDES = 5;
// TubeGeometry needs points that differ.
const MIN_STEP_M = 1e-4;

/** Path of the tool along the plan, or along the checked sequence while its panel is open. */
export class ToolPath implements SceneComponent {
  private line: Mesh | null = null;
  private plan: Plan | null = null;
  private legs: readonly Plan[] = [];
  private arm: RobotModel | null = null;

  constructor(
    private readonly scene: Scene,
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const { sequence, layout, plan: { trajectory: plan } } = state;
    const legs = plan === null && isOpen(layout, "sequence") ? sequence.checks.flatMap((check) => check.plan ?? []) : [];
    const same_legs = legs.length === this.legs.length && legs.every((leg, index) => leg === this.legs[index]);
    if (plan === this.plan && same_legs && this.robot.arm === this.arm) return;
    this.plan = plan;
    this.legs = legs;
    this.arm = this.robot.arm;
    const path = this.path(plan === null ? legs : [plan]);
    this.draw(path);
    this.store.patch("plan", { tool_path: path });
  }

  private path(plans: readonly Plan[]): Point[] {
    const model = this.robot.arm;
    if (model === null) return [];
    const before = model.jointValues();
    const samples = Math.max(MIN_SAMPLES, Math.round(SAMPLES / Math.max(1, plans.length)));
    const points = plans.flatMap((plan) => sampleTimes_s(plan, samples).map((time_s) => {
      model.setJoints(samplePlan(plan, time_s));
      return model.linkPosition_m(this.robot.tip);
    }));
    model.setJoints(before);
    return points.filter((point): point is Point => point !== null && point.every(Number.isFinite));
  }

  private draw(path: Point[]): void {
    this.line?.removeFromParent();
    this.line?.geometry.dispose();
    this.line = null;
    const points = distinctPoints(path);
    if (points.length < 2) return;
    const curve = new CatmullRomCurve3(points, false, "centripetal");
    this.line = new Mesh(new TubeGeometry(curve, points.length, RADIUS_M, SIDES), this.materials.path);
    this.scene.add(this.line);
  }
}

function distinctPoints(path: Point[]): Vector3[] {
  const points: Vector3[] = [];
  for (const point of path.map((values) => new Vector3(...values))) {
    const last = points.at(-1);
    if (last === undefined || last.distanceTo(point) > MIN_STEP_M) points.push(point);
  }
  return points;
}
