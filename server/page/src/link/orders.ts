import { setNotice } from "../state/notices";
import type { JointValues, State, SuggestedGoal } from "../state/state";
import type { Store } from "../state/store";
import type { Link } from "./link";
import { ABORTED } from "./goal-call";
import * as messages from "./messages";
import type { Trigger } from "./wire";

/** Everything but motions that the user asks for; every refusal ends in a notice. */
export class Orders {
  /**
   * @param link - to the server.
   * @param store - where answers go.
   */
  constructor(
    private readonly link: Link,
    private readonly store: Store<State>,
  ) {}

  /** Publish the goal that the server offered in place of a refused one. */
  publishSuggestion({ topic, type, msg }: SuggestedGoal): void {
    this.attempt(() => this.link.publish(topic, type, msg));
  }

  /** Save where the arm is under a name. */
  async savePose(name: string): Promise<boolean> {
    return this.attempt(async () => {
      const request = { name, robot: "", state: {} };
      const { success } = await this.link.call<{ success: boolean }>("/save_robot_state", request);
      const words = success ? `“${name}” is saved` : `“${name}” could not be saved; the log says why`;
      setNotice(this.store, "save", words);
      return success;
    });
  }

  /** Forget a saved pose. */
  async deletePose(name: string): Promise<void> {
    await this.attempt(() => this.link.call("/delete_robot_state", { name, robot: "" }));
  }

  /** Call one of the arm's Trigger services, as `/arm/relax`; says how it ended. */
  async order(service: string): Promise<boolean> {
    return this.attempt(async () => {
      const { success, message } = await this.link.call<Trigger>(service, {});
      setNotice(this.store, "order", success ? "" : `${service}: ${message}`);
      return success;
    });
  }

  /** Take control of the arm from whoever has it. */
  async takeOver(): Promise<void> {
    if (await this.order("/arm/release_control")) await this.order("/arm/take_control");
  }

  /** Change how fast the arm moves along its path, now and in motions to come. */
  setSpeedFactor(factor: number): void {
    this.attempt(() => this.link.publish("/arm/speed_factor", "std_msgs/Float64", { data: factor }));
  }

  /** Bring the gripper to a position. */
  async moveGripper(position_rad: number): Promise<void> {
    await this.attempt(async () => {
      const action = "/gripper_controller/gripper_cmd";
      const type = "control_msgs/action/GripperCommand";
      const { status, values, reason } = await this.link.goal(action, type, messages.gripperGoal(position_rad)).result;
      const refused = status === ABORTED || values === null;
      setNotice(this.store, "gripper", refused ? `Gripper: ${reason || "the goal was aborted; the log says why"}` : "");
    });
  }

  /** Put a box into the planning scene, move a thing, or take it away. */
  changeScene(object: object): void {
    this.attempt(() => this.link.publish("/collision_object", "moveit_msgs/CollisionObject", object));
  }

  /** Turn joints while this is called again and again: shares of the servo's joint speed. */
  jog(velocities: JointValues): void {
    this.attempt(() => this.link.publish("/servo_node/delta_joint_cmds", "control_msgs/JointJog", messages.jointJog(velocities)));
  }

  /** End one goal, in hand or waiting, whoever sent it. */
  cancelGoal(id: string): void {
    this.attempt(() => this.link.publish("/moveit_goal_cancel", "std_msgs/String", { data: id }));
  }

  private async attempt(act: () => unknown): Promise<boolean> {
    try {
      return (await act()) !== false;
    } catch (error) {
      setNotice(this.store, "link", (error as Error).message);
      return false;
    }
  }
}
