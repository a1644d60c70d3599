import { Box3, CircleGeometry, Group, Matrix4, Mesh, PlaneGeometry, Vector3, type Material, type Object3D } from "three";
import { ticksToRadians } from "../logic/commissioning";
import type { State } from "../state/state";
import type { Materials } from "./appearance";
import type { Robot } from "./robot";
import type { SceneComponent } from "./viewer";

// Large enough to be seen beside the links, small enough to stay in the picture.
const MIN_RADIUS_M = 0.05;
const MAX_RADIUS_M = 0.15;

const LINE_M = 0.004;

/** Segments of a whole turn: 5 degrees each look round. */
const SEGMENTS = 72;

/** A projection onto the plane of rotation that is shorter has no reliable direction. */
const MIN_ASIDE_M = 0.005;

export interface AxisJoint extends Object3D {
  axis: Vector3;
}

/** Sector about a joint, from the lowest to the highest position it has been moved to; it turns with the joint. */
export class Sector {
  private readonly group = new Group();
  private readonly fan: Mesh;
  private readonly radius_m: number;

  constructor(joint: AxisJoint, material: Material, line_material: Material) {
    const along = directionOfChild(joint);
    this.radius_m = Math.min(Math.max(along.length(), MIN_RADIUS_M), MAX_RADIUS_M);
    const axis = joint.axis.clone().normalize();
    const aside = along.clone().addScaledVector(axis, -along.dot(axis));
    const toward = aside.length() > MIN_ASIDE_M ? aside.normalize() : perpendicularTo(axis);
    this.group.quaternion.setFromRotationMatrix(new Matrix4().makeBasis(toward, axis.clone().cross(toward), axis));
    this.fan = new Mesh(new CircleGeometry(this.radius_m, 1, 0, 0), material);
    const line = new Mesh(new PlaneGeometry(this.radius_m, LINE_M), line_material);
    line.position.x = this.radius_m / 2;
    // After the arm and before the labels; the line over the sector.
    this.fan.renderOrder = 1;
    line.renderOrder = 2;
    this.group.add(this.fan, line);
    joint.add(this.group);
  }

  /** Show a range; both angles are relative to the joint's present position [rad]. */
  show(lowest_rad: number, highest_rad: number): void {
    const width_rad = Math.min(Math.max(highest_rad - lowest_rad, 0), 2 * Math.PI);
    const segments = Math.max(1, Math.ceil((width_rad / (2 * Math.PI)) * SEGMENTS));
    this.fan.geometry.dispose();
    this.fan.geometry = new CircleGeometry(this.radius_m, segments, lowest_rad, width_rad);
  }

  dispose(): void {
    this.group.removeFromParent();
    for (const part of this.group.children) if (part instanceof Mesh) part.geometry.dispose();
  }
}

/** Return the direction from a joint to the middle of what it moves, in the joint's own frame. */
function directionOfChild(joint: Object3D): Vector3 {
  joint.updateWorldMatrix(true, true);
  const box = new Box3().setFromObject(joint);
  return box.isEmpty() ? new Vector3() : joint.worldToLocal(box.getCenter(new Vector3()));
}

function perpendicularTo(axis: Vector3): Vector3 {
  const other = Math.abs(axis.x) < 0.9 ? new Vector3(1, 0, 0) : new Vector3(0, 1, 0);
  return other.cross(axis).normalize();
}

export class SweptRange implements SceneComponent {
  private sector: Sector | null = null;
  private shown: [unknown, unknown] = [null, null];
  private range: [number, number] | null = null;

  constructor(
    private readonly robot: Robot,
    private readonly materials: Materials,
  ) {}

  update({ commissioning, joint_in_hand }: State): void {
    const swept = commissioning?.joints.find(({ joint }) => joint === joint_in_hand?.joint);
    const joint = this.robot.arm?.robot.joints[swept?.joint ?? ""];
    const has_range = swept !== undefined && swept.highest > swept.lowest;
    // A joint that slides has no angle to draw.
    this.attach(has_range && joint?.jointType !== "prismatic" ? joint : undefined);
    if (!has_range || joint_in_hand === null || this.sector === null) return;
    const ends = [swept.lowest, swept.highest].map((end) => joint_in_hand.direction * ticksToRadians(end - swept.present));
    const range: [number, number] = [Math.min(...ends), Math.max(...ends)];
    if (range.every((end, index) => end === this.range?.[index])) return;
    this.range = range;
    this.sector.show(...range);
  }

  private attach(joint: AxisJoint | undefined): void {
    const wanted: [unknown, unknown] = [this.robot.arm, joint];
    if (wanted.every((each, index) => each === this.shown[index])) return;
    this.shown = wanted;
    this.sector?.dispose();
    this.sector = joint === undefined ? null : new Sector(joint, this.materials.swept, this.materials.swept_now);
    this.range = null;
  }
}
