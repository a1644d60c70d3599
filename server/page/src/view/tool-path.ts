import { CatmullRomCurve3, Mesh, TubeGeometry, Vector3, type Scene } from "three";
import { samplePlan, sampleTimes_s } from "../logic/trajectory";
import type { Plan, Point, State } from "../state/state";
import type { Figure } from "./figure";
import type { Materials } from "./materials";
import type { PageStore, Part } from "./part";
import type { Robot } from "./robot";

// Closer than the eye sees on a path of half a metre.
const SAMPLES = 120;
const RADIUS_M = 0.0015;
const SIDES = 5;
// A path of no length is no tube.
const SHORTEST_M = 1e-4;

/** The way of the tool along the plan, by the kinematics of the robot description. */
export class ToolPath implements Part {
  private line: Mesh | null = null;
  private plan: Plan | null = null;
  private arm: Figure | null = null;

  /**
   * @param scene - what the line is put into.
   * @param robot - the robot that is shown.
   * @param store - where the way is told.
   * @param materials - how the line is painted.
   */
  constructor(
    private readonly scene: Scene,
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const plan = state.plan.trajectory;
    if (plan === this.plan && this.robot.arm === this.arm) return;
    this.plan = plan;
    this.arm = this.robot.arm;
    const path = plan === null ? [] : this.path(plan);
    this.draw(path);
    this.store.patch("plan", { tool_path: path });
  }

  private path(plan: Plan): Point[] {
    const figure = this.robot.arm;
    if (figure === null) return [];
    const before = figure.jointValues();
    const points = sampleTimes_s(plan, SAMPLES).map((time_s) => {
      figure.setJoints(samplePlan(plan, time_s));
      return figure.linkPosition_m(this.robot.tip);
    });
    figure.setJoints(before);
    return points.filter((point): point is Point => point !== null && point.every(Number.isFinite));
  }

  private draw(path: Point[]): void {
    this.line?.removeFromParent();
    this.line?.geometry.dispose();
    this.line = null;
    const points = apart(path);
    if (points.length < 2) return;
    const curve = new CatmullRomCurve3(points, false, "centripetal");
    this.line = new Mesh(new TubeGeometry(curve, points.length * 2, RADIUS_M, SIDES), this.materials.path);
    this.scene.add(this.line);
  }
}

function apart(path: Point[]): Vector3[] {
  const points: Vector3[] = [];
  for (const point of path.map((values) => new Vector3(...values))) {
    const last = points.at(-1);
    if (last === undefined || last.distanceTo(point) > SHORTEST_M) points.push(point);
  }
  return points;
}
