import { armGripper, armNamespace } from "../logic/joints";
import type { State } from "../state/state";
import { selectGroup, setNotice, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { STATUS_ABORTED, type Connection, type GoalHandle } from "./connection";
import { gripperGoal, type TriggerResponse } from "./messages";

/** Requests of the user other than planned motions; every rejection becomes a notice. */
export class ArmCommands {
  private gripper_goal: GoalHandle<unknown> | null = null;

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {}

  /** Publish a message; a notice has the reason when it cannot be sent. */
  publish(topic: string, type: string, msg: unknown): void {
    this.attempt(() => this.connection.publish(topic, type, msg));
  }

  async savePose(name: string): Promise<boolean> {
    return this.attempt(async () => {
      const request = { name, robot: "", state: {} };
      const { success, refusal } = await this.connection.call<{ success: boolean }>("/save_robot_state", request);
      setNotice(this.store, "save", t(success ? "answer.saved" : "answer.not_saved", { name, reason: refusal }));
      return success;
    });
  }

  async deletePose(name: string): Promise<void> {
    await this.attempt(() => this.connection.call("/delete_robot_state", { name, robot: "" }));
  }

  /** Call one of the arm's services that answer as a Trigger, such as `/arm/relax`; return its success. */
  async trigger(service: string, request: object = {}): Promise<boolean> {
    return this.attempt(async () => {
      const { success, message } = await this.connection.call<TriggerResponse>(service, request);
      setNotice(this.store, "order", success ? "" : `${service}: ${message}`);
      return success;
    });
  }

  async takeOver(): Promise<void> {
    if (await this.trigger("/arm/release_control")) await this.trigger("/arm/take_control");
  }

  /** Set the share of the joints' speed limits that no motion of the planning group's arm exceeds; return the success. */
  async setSpeedLimit(limit: number): Promise<boolean> {
    return this.trigger(`${armNamespace(this.store.state)}/arm/set_speed_limit`, { speed_limit: limit });
  }

  /** Select the joint group that goals are for, of this page and of the server's goal topics. */
  selectGroup(group: string): void {
    selectGroup(this.store, group);
    this.publish("/moveit_goal_group", "std_msgs/String", { data: group });
  }

  /** Move the gripper to a position [rad or m]. */
  async moveGripper(position: number): Promise<void> {
    await this.attempt(async () => {
      const gripper = armGripper(this.store.state);
      if (gripper === null) return;
      this.gripper_goal = this.connection.goal(gripper.action, "control_msgs/action/GripperCommand", gripperGoal(position));
      const { status, values, reason } = await this.gripper_goal.result;
      const refused = status === STATUS_ABORTED || values === null;
      const text = t("answer.gripper", { reason: reason || t("answer.gripper.aborted") });
      setNotice(this.store, "gripper", refused ? text : "");
    });
  }

  /** Cancel the last motion of the gripper that this page has asked for. */
  cancelGripper(): void {
    this.gripper_goal?.cancel();
  }

  /** Have the plan of a goal that waits carried out, or cancel a goal of any client. */
  decide(id: string, decision: "approve" | "cancel"): void {
    this.publish(`/moveit_goal_${decision}`, "std_msgs/String", { data: id });
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

/** Time for the answer of /arm/stop [s]; the server answers within 6 s, when the arm stands. */
const STOP_TIMEOUT_S = 7;

const ACKNOWLEDGEMENT_MS = 4000;

/** Stop of the arm, with the server's acknowledgement. */
export class StopCommand {
  private presses = 0;

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
    private readonly cancel: () => void,
  ) {}

  /** Stop by a message, which is fastest, and by a service call, which is acknowledged. */
  async stop(): Promise<void> {
    this.presses += 1;
    const press = this.presses;
    this.store.set({ stop: { phase: "asked", text: t("stop.asked") } });
    const stop = await this.request();
    // A later press shows its own answer.
    if (press !== this.presses) return;
    this.store.set({ stop });
    if (stop.phase !== "acknowledged") return;
    setTimeout(() => press === this.presses && this.store.set({ stop: { phase: "ready", text: "" } }), ACKNOWLEDGEMENT_MS);
  }

  private async request(): Promise<State["stop"]> {
    try {
      this.publishStop();
      const { success, message } = await this.connection.call<TriggerResponse>("/arm/stop", {}, STOP_TIMEOUT_S);
      if (!success) return { phase: "failed", text: t("stop.failed", { reason: message }) };
      return { phase: "acknowledged", text: t("stop.acknowledged", { message: message || t("stop.stands") }) };
    } catch (error) {
      return { phase: "failed", text: t("stop.unacknowledged", { reason: (error as Error).message }) };
    }
  }

  /** Publish the stop, and let go of all that this page holds, also without a connection. */
  private publishStop(): void {
    try {
      this.connection.publish("/stop", "std_msgs/Empty", {});
    } finally {
      this.cancel();
    }
  }
}
