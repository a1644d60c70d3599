import { Matrix4, Mesh, Quaternion, Vector3, type Material, type Object3D } from "three";
import URDFLoader, { type URDFRobot, type URDFVisual } from "urdf-loader";
import type { JointValues, Point } from "../state/state";
import type { Description } from "./description";
import type { Meshes } from "./meshes";

/** Chooses how a shape of a link is drawn; null leaves what the description says. */
export type Paint = (shape: Element | null, link_index: number) => Material | null;

/** What a figure is made of: how the robot looks, or what is checked for contacts. */
export type Shapes = "visual" | "collision";

/** One drawing of the robot, in a pose of its own. */
export class Figure {
  /** What is put into a scene. */
  readonly robot: URDFRobot;
  /** Joints that can move by themselves. */
  readonly joint_names: ReadonlySet<string>;

  /**
   * @param description - of the robot.
   * @param meshes - where its meshes come from.
   * @param shapes - which of its shapes are drawn.
   * @param paint - how they are drawn.
   * @param changed - called when a mesh has come.
   */
  constructor(description: Description, meshes: Meshes, shapes: Shapes, paint: Paint, changed: () => void) {
    const loader = new URDFLoader();
    loader.parseVisual = shapes === "visual";
    loader.parseCollision = shapes === "collision";
    // Names are resolved by Meshes, which knows what may be asked for.
    loader.packages = (name) => `package://${name}`;
    loader.loadMeshCb = (uri, _manager, material, loaded) => {
      void meshes.get(uri).then((mesh) => {
        if (mesh.name !== "placeholder") dress(mesh, material);
        loaded(mesh);
        // A description in millimetres scales its meshes; the box in place of one has metres.
        if (mesh.name === "placeholder" && mesh.parent) mesh.scale.divide(mesh.parent.scale);
        paintAll(this.robot, paint);
        changed();
      });
    };
    this.robot = loader.parse(description.document);
    const movable = Object.values(this.robot.joints).filter((joint) => joint.jointType !== "fixed");
    // The arm is drawn where it is, also beyond a limit.
    for (const joint of movable) joint.ignoreLimits = true;
    this.joint_names = new Set(movable.map((joint) => joint.name));
    paintAll(this.robot, paint);
  }

  /** Brings joints to values; others stay. */
  setJoints(values: JointValues): void {
    this.robot.setJointValues(values);
  }

  /** Where the joints are drawn now. */
  jointValues(): JointValues {
    return Object.fromEntries([...this.joint_names].map((name) => [name, this.robot.joints[name]?.angle ?? 0]));
  }

  /** Where a link is in the root link's frame; null for one that is not known. */
  linkPosition_m(link: string): Point | null {
    const pose = this.linkPose(link);
    if (pose === null) return null;
    const at = new Vector3().setFromMatrixPosition(pose);
    return [at.x, at.y, at.z];
  }

  /** Takes it out of its scene and frees its shapes. */
  dispose(): void {
    this.robot.removeFromParent();
    this.robot.traverse((node) => {
      if (node instanceof Mesh && !isFetched(node)) node.geometry.dispose();
    });
  }

  private linkPose(link: string): Matrix4 | null {
    const node = this.robot.links[link];
    if (node === undefined) return null;
    node.updateWorldMatrix(true, false);
    return new Matrix4().copy(this.robot.matrixWorld).invert().multiply(node.matrixWorld);
  }
}

/** Turns what was read of a pose, x, y, z, w, into three's form. */
export function quaternion(orientation: readonly [number, number, number, number]): Quaternion {
  return new Quaternion(...orientation).normalize();
}

function dress(mesh: Object3D, material: Material): void {
  mesh.userData["fetched"] = true;
  mesh.traverse((node) => {
    // A Collada file brings its own colours; the others take those of the description.
    if (node instanceof Mesh && (node.material as Material).name === "") node.material = material;
  });
}

function isFetched(node: Object3D): boolean {
  for (let at: Object3D | null = node; at !== null; at = at.parent) if (at.userData["fetched"] === true) return true;
  return false;
}

function paintAll(robot: URDFRobot, paint: Paint): void {
  Object.values(robot.links).forEach((link, index) => {
    for (const part of link.children) {
      if (!("isURDFVisual" in part) && !("isURDFCollider" in part)) continue;
      const element = (part as unknown as URDFVisual).urdfNode;
      part.traverse((node) => {
        if (!(node instanceof Mesh) || node.name === "placeholder") return;
        node.material = paint(element, index) ?? node.material;
      });
    }
  });
}
