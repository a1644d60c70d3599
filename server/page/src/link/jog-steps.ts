import { Quaternion, Vector3 } from "three";
import { isRotation, type JogCommand, type TipAxis } from "../logic/jog";
import { armJoints, currentPositions, openedBy } from "../logic/joints";
import { denialReason } from "../logic/permissions";
import { planningGroup } from "../logic/robot-info";
import type { JointValues, Orientation, Point } from "../state/state";
import { setNotice, type PageStore } from "../state/store";
import type { ArmCommands } from "./commands";
import type { Connection } from "./connection";
import { HEADER, pose, SUCCESS, valuesByJoint, type GetPositionFKResponse, type JointState, type MoveItErrorCodes, type Pose } from "./messages";
import type { MoveGroupClient } from "./move-group";
import type { JogSender } from "./servo-node";

/** Share of the joints' speed limits of a step at the full speed of driving: that of planned motions. */
const FULL_SPEED = 0.3;
const LEAST_SPEED = 0.01;

/** Steps of a chosen size, as goals: a step arrives however busy the machine is, and quick presses add up. */
export class JogSteps {
  /** Goal of the step in progress; null without one, when a step begins where the arm is commanded to be. */
  private goal_rad: JointValues | null = null;
  private gripper: number | null = null;
  /** Presses are worked off one after the other: each needs the goal of the one before. */
  private turn: Promise<void> = Promise.resolve();
  /** Number of stops: presses from before the newest stop move nothing. */
  private stops = 0;

  constructor(
    private readonly connection: Pick<Connection, "call">,
    private readonly store: PageStore,
    private readonly moveGroup: Pick<MoveGroupClient, "moveTo">,
    private readonly commands: Pick<ArmCommands, "moveGripper">,
    private readonly jogSender: JogSender,
  ) {
    jogSender.onReleaseAll(() => {
      this.stops += 1;
      this.goal_rad = this.gripper = null;
    });
  }

  /** Move by a step of a size [m or rad, for the gripper a share of its range], at a share of the full speed, 0 to 1. */
  step(command: JogCommand, size: number, share: number): void {
    const { state } = this.store;
    if (this.jogSender.busy || !state.link.connected || denialReason("drive", state) !== "") return;
    const { stops } = this;
    this.turn = this.turn.then(async () => {
      try {
        if (command.kind === "gripper") return this.moveGripper((command.velocity.opening ?? 0) * size, stops);
        const goal_rad = await this.goalAfter(command, size);
        if (stops !== this.stops) return;
        setNotice(this.store, "step", "");
        this.goal_rad = goal_rad;
        // Not waited for: the next press replaces the motion.
        void this.moveGroup.moveTo(goal_rad, Math.max(LEAST_SPEED, share * FULL_SPEED)).then(() => {
          if (this.goal_rad === goal_rad) this.goal_rad = null;
        });
      } catch (error) {
        setNotice(this.store, "step", (error as Error).message);
      }
    });
  }

  /** Return the joint values after a step from the goal of the step before, else from the commanded positions. */
  private async goalAfter({ kind, velocity }: JogCommand, size: number): Promise<JointValues> {
    const { state } = this.store;
    const commanded = { ...currentPositions(state), ...state.commanded_rad };
    const start_rad = this.goal_rad ?? Object.fromEntries(armJoints(state).map((name) => [name, commanded[name] ?? 0]));
    const [[name, sign] = ["", 0]] = Object.entries(velocity);
    if (kind === "tip") return this.tipMoved(start_rad, name as TipAxis, (sign ?? 0) * size);
    const [lower, upper] = state.limits[name] ?? [-Infinity, Infinity];
    const moved = (start_rad[name] ?? 0) + (sign ?? 0) * size;
    return { ...start_rad, [name]: Math.min(Math.max(moved, lower), upper) };
  }

  private async tipMoved(start_rad: JointValues, axis: TipAxis, way: number): Promise<JointValues> {
    const group = planningGroup(this.store.state);
    const robot_state = { joint_state: { name: Object.keys(start_rad), position: Object.values(start_rad) } };
    const request = { header: HEADER, fk_link_names: [group?.tip ?? ""], robot_state };
    const { pose_stamped: [tip], error_code } = await this.connection.call<GetPositionFKResponse>("/compute_fk", request);
    if (tip === undefined) throw new Error(error_code.message);
    const ik_request = { group_name: group?.name ?? "", robot_state, avoid_collisions: true, pose_stamped: { header: HEADER, pose: moved(tip.pose, axis, way, this.jogSender.frame === "tool") } };
    const answer = await this.connection.call<IkResponse>("/compute_ik", { ik_request });
    if (answer.error_code.val !== SUCCESS) throw new Error(answer.error_code.message);
    const { name, position } = answer.solution.joint_state;
    const found = valuesByJoint(name, position);
    return Object.fromEntries(Object.keys(start_rad).map((each) => [each, found[each] ?? start_rad[each] ?? 0]));
  }

  private moveGripper(way: number, stops: number): void {
    const position = openedBy(this.store.state, way, this.gripper);
    if (position === null || stops !== this.stops) return;
    this.gripper = position;
    void this.commands.moveGripper(position).then(() => {
      if (this.gripper === position) this.gripper = null;
    });
  }
}

interface IkResponse {
  solution: { joint_state: JointState };
  error_code: MoveItErrorCodes;
}

function moved({ position, orientation: { x, y, z, w } }: Pose, axis: TipAxis, way: number, in_tool: boolean): object {
  const orientation = new Quaternion(x, y, z, w);
  const index = ["x", "y", "z", "roll", "pitch", "yaw"].indexOf(axis) % 3;
  const direction = new Vector3().setComponent(index, 1);
  if (in_tool) direction.applyQuaternion(orientation);
  const point = new Vector3(position.x, position.y, position.z);
  if (isRotation(axis)) orientation.premultiply(new Quaternion().setFromAxisAngle(direction, way));
  else point.addScaledVector(direction, way);
  return pose(point.toArray() as Point, orientation.toArray() as Orientation);
}
