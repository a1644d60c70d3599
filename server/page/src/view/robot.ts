import type { Object3D, Scene } from "three";
import { planningGroup } from "../logic/robot-info";
import { jointReport, unknownNamesText, withoutNumberText } from "../logic/joints";
import type { Joints, State } from "../state/state";
import { clearNotices, setNotice, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Materials, Theme } from "./appearance";
import { Meshes } from "./meshes";
import { RobotModel, type GeometryKind, type MaterialSelector } from "./robot-model";
import type { SceneComponent } from "./viewer";

/** Parse a robot description, whose links and joints the server has checked; throw an Error with the reason when it is none. */
function parseDescription(urdf: string): Document {
  const xml = new DOMParser().parseFromString(urdf, "text/xml");
  const broken = xml.querySelector("parsererror")?.textContent;
  if (broken) {
    const reason = broken.match(/error on line \d+[^\n]*/)?.[0].trim() ?? t("picture.urdf.unreadable");
    throw new Error(t("picture.urdf.no_xml", { reason }));
  }
  const { nodeName: name, children } = xml.documentElement;
  if (name !== "robot") throw new Error(t("picture.urdf.root", { name }));
  if (![...children].some((child) => child.nodeName === "link")) throw new Error(t("picture.urdf.no_link"));
  return xml;
}

/** Return the name of the link that the most joints carry, for use as the tip. */
function farthestLink({ robot }: RobotModel): string {
  const depth = ({ parent }: Object3D): number => (parent === null ? 0 : 1 + depth(parent));
  const depths = Object.entries(robot.links).map(([name, link]) => [name, depth(link)] as const);
  return depths.reduce((best, each) => (each[1] > best[1] ? each : best), ["", 0] as const)[0];
}

export class Robot implements SceneComponent {
  /** Model of the arm in its measured pose; null until there is a description. */
  arm: RobotModel | null = null;
  tip = "";
  private description: Document | null = null;
  private meshes: Meshes | null = null;
  private urdf: string | null = null;
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
      const description = parseDescription(urdf);
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
    this.farthest_link = this.arm === null ? "" : farthestLink(this.arm);
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
