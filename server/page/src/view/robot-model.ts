import { Box3, Matrix4, Mesh, Quaternion, Vector3, type Material, type Object3D } from "three";
import URDFLoader, { type URDFRobot, type URDFVisual } from "urdf-loader";
import type { JointValues, Orientation, Point } from "../state/state";
import { mergeShapes } from "./merged-shapes";
import type { Meshes } from "./meshes";
import { roundShapes } from "./rounded-shapes";

/** Function that returns the material of a link's shape; null keeps that of the description. */
export type MaterialSelector = (shape: Element | null, link_index: number) => Material | null;

/** Geometry of a URDF link: its visuals, or the shapes that are checked for collisions. */
export type GeometryKind = "visual" | "collision";

export class RobotModel {
  readonly robot: URDFRobot;
  readonly joint_names: ReadonlySet<string>;

  constructor(
    description: Document,
    meshes: Meshes,
    geometry_kind: GeometryKind,
    selectMaterial: MaterialSelector,
    changed: () => void,
  ) {
    const loader = new URDFLoader();
    loader.parseVisual = geometry_kind === "visual";
    loader.parseCollision = geometry_kind === "collision";
    // Meshes resolves package names, as it knows the paths that the server permits.
    loader.packages = (name) => `package://${name}`;
    loader.loadMeshCb = (uri, _manager, material, loaded) => {
      void meshes.get(uri).then((mesh) => {
        if (mesh.name !== "placeholder") applyDescriptionMaterial(mesh, material);
        loaded(mesh);
        // A description in millimetres scales its meshes; the placeholder has metres.
        if (mesh.name === "placeholder" && mesh.parent) mesh.scale.divide(mesh.parent.scale);
        applyMaterials(this.robot, selectMaterial);
        changed();
      });
    };
    this.robot = loader.parse(description);
    // Collision shapes keep their edges, as these are what is checked.
    if (geometry_kind === "visual") roundShapes(this.robot);
    const movable = Object.values(this.robot.joints).filter((joint) => joint.jointType !== "fixed");
    // The arm is drawn at its measured position, also beyond a limit.
    for (const joint of movable) joint.ignoreLimits = true;
    this.joint_names = new Set(movable.map((joint) => joint.name));
    applyMaterials(this.robot, selectMaterial);
    for (const link of Object.values(this.robot.links)) mergeShapes(link.children.filter(isShape));
  }

  setJoints(values: JointValues): void {
    this.robot.setJointValues(values);
  }

  jointValues(): JointValues {
    return Object.fromEntries([...this.joint_names].map((name) => [name, this.robot.joints[name]?.angle ?? 0]));
  }

  linkPosition_m(link: string): Point | null {
    const pose = this.linkPose(link);
    if (pose === null) return null;
    const { x, y, z } = new Vector3().setFromMatrixPosition(pose);
    return [x, y, z];
  }

  linkOrientation(link: string): Orientation | null {
    const pose = this.linkPose(link);
    if (pose === null) return null;
    const { x, y, z, w } = new Quaternion().setFromRotationMatrix(pose);
    return [x, y, z, w];
  }

  /** Return the sizes of the bounds of the last drawn link before a tip, in that link's frame [m]. */
  endSizes_m(tip: string): number[] {
    let link: Object3D | null = this.robot.links[tip] ?? null;
    for (; link !== null && link !== this.robot; link = link.parent) {
      const shapes = link.children.filter((part) => "isURDFVisual" in part);
      if (!("isURDFLink" in link) || shapes.length === 0) continue;
      link.updateWorldMatrix(true, true);
      const to_link = new Matrix4().copy(link.matrixWorld).invert();
      const bounds = new Box3();
      for (const shape of shapes) shape.traverse((node) => node instanceof Mesh && extend(bounds, node, to_link));
      return bounds.isEmpty() ? [] : bounds.getSize(new Vector3()).toArray();
    }
    return [];
  }

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

function extend(bounds: Box3, mesh: Mesh, to_link: Matrix4): void {
  mesh.geometry.computeBoundingBox();
  const box = mesh.geometry.boundingBox;
  if (box !== null) bounds.union(box.clone().applyMatrix4(new Matrix4().multiplyMatrices(to_link, mesh.matrixWorld)));
}

/** Convert an orientation x, y, z, w to three's quaternion of length 1. */
export function toQuaternion(orientation: Readonly<Orientation>): Quaternion {
  return new Quaternion(...orientation).normalize();
}

function applyDescriptionMaterial(mesh: Object3D, material: Material): void {
  mesh.userData.fetched = true;
  mesh.traverse((node) => {
    // A Collada file has its own colours; other files take those of the description.
    if (node instanceof Mesh && (node.material as Material).name === "") node.material = material;
  });
}

function isFetched(node: Object3D): boolean {
  for (let at: Object3D | null = node; at !== null; at = at.parent) if (at.userData.fetched === true) return true;
  return false;
}

function isShape(part: Object3D): boolean {
  return "isURDFVisual" in part || "isURDFCollider" in part;
}

function applyMaterials(robot: URDFRobot, selectMaterial: MaterialSelector): void {
  Object.values(robot.links).forEach((link, index) => {
    for (const part of link.children) {
      if (!isShape(part)) continue;
      const element = (part as unknown as URDFVisual).urdfNode;
      part.traverse((node) => {
        if (!(node instanceof Mesh) || node.name === "placeholder") return;
        node.material = selectMaterial(element, index) ?? node.material;
      });
    }
  });
}
