import { Vector3 } from "three";
import { distanceText, ghostPose, type GhostPose } from "../logic/ghost";
import { jointReport } from "../logic/joint-report";
import type { Joints, JointValues, Point, State } from "../state/state";
import type { Figure } from "./figure";
import type { Label } from "./label";
import type { Materials } from "./materials";
import type { Part } from "./part";
import type { Robot } from "./robot";

/** The arm as it will stand: at the end of a plan, where the scrubber is, or as near to the target as it gets. */
export class Ghost implements Part {
  /** Where its tool is; null while there is no ghost. */
  tool_m: Point | null = null;
  private figure: Figure | null = null;
  private arm: Figure | null = null;
  private shown: [unknown, unknown, unknown, unknown] | null = null;

  /**
   * @param robot - the robot that is shown.
   * @param materials - how the ghost is painted.
   * @param label - says how far off the target it stays.
   */
  constructor(
    private readonly robot: Robot,
    private readonly materials: Materials,
    private readonly label: Label,
  ) {}

  update(state: State): void {
    if (this.robot.arm === null) return;
    if (this.robot.arm !== this.arm) this.drop();
    const pose = ghostPose(state);
    const inputs: [unknown, unknown, unknown, unknown] = [state.plan, state.target, state.wish, state.joints];
    // Joints that nothing is asked of are drawn where the arm is, so the ghost follows /joint_states too.
    if (this.shown?.every((input, index) => input === inputs[index])) return;
    this.shown = inputs;
    if (pose === null) this.hide();
    else this.show(pose, state);
  }

  private show(pose: GhostPose, state: State): void {
    this.figure ??= this.robot.figure("visual", () => this.materials.ghost);
    if (this.figure === null) return;
    this.figure.robot.visible = true;
    this.figure.setJoints({ ...present(state.joints, this.figure), ...finite(pose.joints_rad) });
    this.tool_m = this.figure.linkPosition_m(this.robot.tip);
    this.materials.setOffTarget(pose.off_target_m !== null);
    const off = pose.off_target_m;
    const at = state.target.position_m ?? this.tool_m;
    this.label.show(off === null || at === null ? "" : `${distanceText(off)} off`, new Vector3(...(at ?? [0, 0, 0])));
  }

  private hide(): void {
    if (this.figure !== null) this.figure.robot.visible = false;
    this.tool_m = null;
    this.label.show("", new Vector3());
  }

  private drop(): void {
    this.arm = this.robot.arm;
    this.figure?.dispose();
    this.figure = null;
    this.shown = null;
  }
}

function present(joints: Joints, figure: Figure): JointValues {
  return jointReport(joints, figure.joint_names).values;
}

function finite(values: JointValues): JointValues {
  return Object.fromEntries(Object.entries(values).filter(([, value]) => Number.isFinite(value)));
}
