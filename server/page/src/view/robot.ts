import type { Scene } from "three";
import { jointReport, unknownNamesText, withoutNumberText } from "../logic/joints";
import type { Joints, State } from "../state/state";
import { clearNotices, setNotice, type PageStore } from "../state/store";
import type { Materials, Theme } from "./appearance";
import { Meshes } from "./meshes";
import { farthestLink, readDescription, tipLink, type Description } from "./robot-description";
import { RobotModel, type GeometryKind, type MaterialSelector } from "./robot-model";
import type { SceneComponent } from "./viewer";

/** Robot description, and the models drawn from it. */
export class Robot implements SceneComponent {
  /** Model of the arm in its measured pose; null until there is a description. */
  arm: RobotModel | null = null;
  /** Link of the tool. */
  tip = "";
  private description: Description | null = null;
  private meshes: Meshes | null = null;
  private urdf: string | null = null;
  private srdf: string | null = null;

  /**
   * @param scene - scene to add the models to.
   * @param store - updated with notices.
   * @param materials - materials of the arm.
   * @param theme - returns the present colours.
   * @param changed - called when a mesh has been loaded, and with true for a new description.
   */
  constructor(
    private readonly scene: Scene,
    private readonly store: PageStore,
    private readonly materials: Materials,
    private readonly theme: () => Theme,
    private readonly changed: (is_new: boolean) => void,
  ) {}

  update(state: State): void {
    if (state.urdf !== this.urdf) this.load(state.urdf);
    if (state.srdf !== this.srdf || this.tip === "") this.findTip(state.srdf);
  }

  /** Create another model of the robot; null while there is no description. */
  createModel(geometry_kind: GeometryKind, selectMaterial: MaterialSelector): RobotModel | null {
    if (this.description === null || this.meshes === null) return null;
    const model = new RobotModel(this.description, this.meshes, geometry_kind, selectMaterial, () => {
      this.changed(false);
    });
    this.scene.add(model.robot);
    return model;
  }

  private load(urdf: string | null): void {
    this.urdf = urdf;
    if (urdf === null) return;
    try {
      const description = readDescription(urdf);
      clearNotices(this.store, "view:mesh:");
      this.meshes = new Meshes((uri, text) => setNotice(this.store, `view:mesh:${uri}`, text), this.theme().missing);
      const before = this.arm;
      this.description = description;
      this.arm = this.createModel("visual", this.materials.armMaterial);
      before?.dispose();
      setNotice(this.store, "view:urdf", "");
    } catch (error) {
      const kept = this.arm === null ? "No arm is drawn" : "The arm before it is drawn still";
      setNotice(this.store, "view:urdf", `The robot description cannot be drawn: ${(error as Error).message}. ${kept}.`);
      return;
    }
    this.tip = "";
    this.changed(true);
  }

  private findTip(srdf: string | null): void {
    this.srdf = srdf;
    if (this.description === null) return;
    const tip = tipLink(srdf);
    const is_known = tip !== null && this.description.parts.links.includes(tip);
    this.tip = is_known ? tip : (farthestLink(this.description.parts) ?? "");
  }
}

/** Display of /joint_states by the arm, and by its collision shapes while they are shown. */
export class JointStateDisplay implements SceneComponent {
  private joints: Joints | null = null;
  private arm: RobotModel | null = null;
  private collision: RobotModel | null = null;

  /**
   * @param robot - robot that is shown.
   * @param store - updated with notices and the tool's position.
   * @param materials - materials of the collision shapes.
   */
  constructor(
    private readonly robot: Robot,
    private readonly store: PageStore,
    private readonly materials: Materials,
  ) {}

  update(state: State): void {
    const arm = this.robot.arm;
    if (arm === null) return;
    const is_new = arm !== this.arm;
    if (is_new) this.replace(arm);
    const toggled = this.showCollision(state.collision_shapes);
    if (!is_new && !toggled && state.joints === this.joints) return;
    this.joints = state.joints;
    this.move(arm, state.joints);
  }

  private replace(arm: RobotModel): void {
    this.arm = arm;
    this.collision?.dispose();
    this.collision = null;
  }

  private move(arm: RobotModel, joints: Joints): void {
    const report = jointReport(joints, arm.joint_names);
    setNotice(this.store, "view:joint-names", unknownNamesText(report, arm.joint_names));
    setNotice(this.store, "view:joint-numbers", withoutNumberText(report));
    arm.setJoints(report.values);
    this.collision?.setJoints(report.values);
    const tool_m = arm.linkPosition_m(this.robot.tip);
    const before_m = this.store.state.tool_m;
    if (tool_m?.some((value, axis) => value !== before_m?.[axis])) this.store.set({ tool_m });
  }

  private showCollision(shown: boolean): boolean {
    if (shown === (this.collision !== null)) return false;
    if (shown) {
      this.collision = this.robot.createModel("collision", () => this.materials.collision);
    } else {
      this.collision?.dispose();
      this.collision = null;
    }
    return true;
  }
}
