import { jointReport, unknownNamesText, withoutNumberText } from "../logic/joint-report";
import type { Joints, State } from "../state/state";
import type { Figure } from "./figure";
import type { Materials } from "./materials";
import { notice } from "./notices";
import type { PageStore, Part } from "./part";
import type { Robot } from "./robot";

/** Moves the arm, and its collision shapes when they are shown, as /joint_states says. */
export class Arm implements Part {
  private joints: Joints | null = null;
  private arm: Figure | null = null;
  private collision: Figure | null = null;

  /**
   * @param robot - the robot that is shown.
   * @param store - where messages to the user and the tool's place go.
   * @param materials - how collision shapes are painted.
   */
  constructor(
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const arm = this.robot.arm;
    if (arm === null) return;
    const another = arm !== this.arm;
    if (another) this.drop(arm);
    const toggled = this.showCollision(state.collision_shapes);
    if (!another && !toggled && state.joints === this.joints) return;
    this.joints = state.joints;
    this.move(arm, state.joints);
  }

  private drop(arm: Figure): void {
    this.arm = arm;
    this.collision?.dispose();
    this.collision = null;
  }

  private move(arm: Figure, joints: Joints): void {
    const report = jointReport(joints, arm.joint_names);
    notice(this.store, "joint-names", unknownNamesText(report, arm.joint_names));
    notice(this.store, "joint-numbers", withoutNumberText(report));
    arm.setJoints(report.values);
    this.collision?.setJoints(report.values);
    const tool_m = arm.linkPosition_m(this.robot.tip);
    const known = this.store.state.tool_m;
    if (tool_m?.some((value, axis) => value !== known?.[axis])) this.store.set({ tool_m });
  }

  private showCollision(shown: boolean): boolean {
    if (shown === (this.collision !== null)) return false;
    if (shown) {
      this.collision = this.robot.figure("collision", () => this.materials.collision);
    } else {
      this.collision?.dispose();
      this.collision = null;
    }
    return true;
  }
}
