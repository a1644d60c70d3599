import type { Scene } from "three";
import { planningGroup } from "../logic/robot-info";
import { jointReport, unknownNamesText, withoutNumberText } from "../logic/joints";
import type { Joints, State } from "../state/state";
import { clearNotices, setNotice, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Materials, Theme } from "./appearance";
import { Meshes } from "./meshes";
import { farthestLink, readDescription, type Description } from "./robot-description";
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
  /** Tool of a robot whose semantic description names none. */
  private farthest_link = "";

  constructor(
    private readonly scene: Scene,
    private readonly store: PageStore,
    private readonly materials: Materials,
    private readonly theme: () => Theme,
    private readonly changed: (is_new: boolean) => void,
  ) {}

  update(state: State): void {
    if (state.urdf !== this.urdf) this.load(state.urdf);
    this.tip = this.findTip(planningGroup(state)?.tip ?? null);
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
      const key = this.arm === null ? "picture.urdf.broken" : "picture.urdf.broken_next";
      setNotice(this.store, "view:urdf", t(key, { reason: (error as Error).message }));
      return;
    }
    this.farthest_link = farthestLink(this.description.parts) ?? "";
    this.changed(true);
  }

  private findTip(tip: string | null): string {
    return tip !== null && this.arm?.robot.links[tip] !== undefined ? tip : this.farthest_link;
  }
}

/** Display of /joint_states by the arm, and by its collision shapes while they are shown. */
export class JointStateDisplay implements SceneComponent {
  private joints: Joints | null = null;
  private tip = "";
  private arm: RobotModel | null = null;
  private collision: RobotModel | null = null;

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
    if (!is_new && !toggled && state.joints === this.joints && this.robot.tip === this.tip) return;
    this.joints = state.joints;
    this.tip = this.robot.tip;
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
    const [tool_m, tool_orientation] = [arm.linkPosition_m(this.tip), arm.linkOrientation(this.tip)];
    const before = this.store.state;
    const moved = tool_m?.some((value, axis) => value !== before.tool_m?.[axis]);
    const turned = tool_orientation?.some((value, index) => value !== before.tool_orientation?.[index]);
    if (moved || turned) this.store.set({ tool_m, tool_orientation });
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
