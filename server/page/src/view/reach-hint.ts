import { BufferAttribute, BufferGeometry, Group, LineLoop, Mesh, Vector3 } from "three";
import { armJoints, isOneArm } from "../logic/joints";
import { reachOutline, type ReachOutline } from "../logic/reach";
import type { Point, State } from "../state/state";
import type { Theme } from "./appearance";
import { flatMaterial, setTint } from "./flat-material";
import type { Robot } from "./robot";
import type { RobotModel } from "./robot-model";
import type { SceneComponent } from "./viewer";

const Z_M = -0.0015;
const QUIET_LINE = 0.3;
const QUIET_FILL = 0.05;
const LOUD_LINE = 0.9;
const LOUD_FILL = 0.16;

/** Ground below what the tool reaches: a faint outline, which is plain while the target is in hand. */
export class ReachHint implements SceneComponent {
  readonly group = new Group();
  private readonly fill = flatMaterial(false);
  private readonly line = flatMaterial(false);
  private color = 0;
  private shown: unknown[] = [];
  private outline: ReachOutline | null = null;

  constructor(
    private readonly robot: Robot,
    private readonly is_in_hand: () => boolean,
  ) {}

  setTheme(theme: Theme): void {
    this.color = theme.ghost;
  }

  update(state: State): void {
    const loud = this.is_in_hand();
    setTint(this.fill, this.color, loud ? LOUD_FILL : QUIET_FILL);
    setTint(this.line, this.color, loud ? LOUD_LINE : QUIET_LINE);
    const { arm, tip } = this.robot;
    const inputs = [arm, tip, state.limits, state.group, state.robot];
    if (inputs.every((input, index) => input === this.shown[index])) return;
    this.shown = inputs;
    this.outline = arm === null || !isOneArm(state) ? null : outlineOf(arm, tip, state);
    this.draw();
  }

  private draw(): void {
    for (const part of this.group.children) (part as Mesh).geometry.dispose();
    this.group.clear();
    if (this.outline === null || Math.max(...this.outline.radius_m) === 0) return;
    const { center, radius_m } = this.outline;
    const rim = radius_m.flatMap((radius, sector) => {
      const angle_rad = ((sector + 0.5) / radius_m.length) * 2 * Math.PI;
      return [center[0] + radius * Math.cos(angle_rad), center[1] + radius * Math.sin(angle_rad), Z_M];
    });
    const at = new BufferAttribute(new Float32Array([...rim, ...center, Z_M]), 3);
    const middle = radius_m.length;
    const fan = new BufferGeometry().setAttribute("position", at);
    fan.setIndex(radius_m.flatMap((_, sector) => [middle, sector, (sector + 1) % middle]));
    const edge = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(rim), 3));
    const [area, loop] = [new Mesh(fan, this.fill), new LineLoop(edge, this.line)];
    area.renderOrder = -2;
    loop.renderOrder = -1;
    this.group.add(area, loop);
  }
}

/** Return the outline of a robot's reach about its first joint; null without joints or tool. */
function outlineOf(arm: RobotModel, tip: string, state: State): ReachOutline | null {
  const limits = state.limits;
  const ranges = armJoints(state)
    .filter((name) => arm.joint_names.has(name))
    .map((name) => [name, ...(limits[name] ?? [0, 0])] as [string, number, number])
    .filter(([, low, high]) => Number.isFinite(low) && Number.isFinite(high));
  const first = arm.robot.joints[ranges[0]?.[0] ?? ""];
  if (first === undefined || arm.linkPosition_m(tip) === null) return null;
  const before = arm.jointValues();
  const tool = (shares: readonly number[]): Point => {
    const values = ranges.map(([name, low, high], index) => [name, low + (shares[index] ?? 0) * (high - low)] as const);
    arm.setJoints(Object.fromEntries(values));
    return arm.linkPosition_m(tip) ?? [Number.NaN, 0, 0];
  };
  arm.robot.updateWorldMatrix(true, true);
  const base = arm.robot.worldToLocal(first.getWorldPosition(new Vector3()));
  const outline = reachOutline(tool, ranges.length, [base.x, base.y]);
  arm.setJoints(before);
  return outline;
}
