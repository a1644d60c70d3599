import { armGripper, armJoints } from "../logic/joints";
import { planningGroup } from "../logic/robot-info";
import { asWaypoints, MAX_WAYPOINTS, taughtWaypoint, type Waypoint } from "../logic/sequence";
import { duration_s } from "../logic/trajectory";
import type { Plan } from "../state/state";
import { onConnect, type PageStore } from "../state/store";
import { t } from "../texts/texts";
import { ask, askNames, type Connection, type GoalHandle } from "./connection";
import { readPlan, type JointTrajectory, type ReplayMotionResult, type TriggerResponse } from "./messages";
import { setWaypoints } from "./sequence";

/** Time for making a motion of a recording, or for checking an edited one [s]: minutes of motion take seconds. */
const WORK_TIMEOUT_S = 30;

interface MotionResponse extends TriggerResponse {
  trajectory: JointTrajectory;
}

/** Records motions that a hand shows, keeps them on the server, and replays them. */
export class Teaching {
  private handle: GoalHandle<ReplayMotionResult> | null = null;

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    connection.subscribe("/teach/state", "armbridge_msgs/msg/TeachState", ({ recording, name, duration_s, message }) => {
      store.patch("teaching", { recording: recording ? { name, duration_s: duration_s ?? 0 } : null, told: message });
      // Another client may have recorded, too.
      if (!recording) void this.list();
    });
    onConnect(store, () => void this.list());
  }

  async edit(name: string | null): Promise<void> {
    this.store.patch("teaching", { edited: null });
    if (name === null) return;
    const motion = await this.get(name);
    if (motion) this.store.patch("teaching", { edited: { name, duration_s: duration_s(motion) } });
  }

  async addToSequence(name: string): Promise<void> {
    const motion = await this.get(name);
    if (motion === null) return;
    const { state } = this.store;
    const group = planningGroup(state)?.name ?? "";
    this.extend([taughtWaypoint(state.sequence.waypoints, group, name, motion, armJoints(state))], name);
  }

  /** Add a motion to the sequence, as waypoints by which it can be edited. */
  async addAsWaypoints(name: string): Promise<void> {
    const motion = await this.get(name);
    if (motion === null) return;
    const { state } = this.store;
    const { sequence, settings } = state;
    const gripper = armGripper(state)?.joints[0] ?? null;
    const group = planningGroup(state)?.name ?? "";
    this.extend(asWaypoints(sequence.waypoints, group, name, motion, armJoints(state), gripper, settings.speed), name);
  }

  private extend(added: Waypoint[], name: string): void {
    const { waypoints, playing } = this.store.state.sequence;
    const full = playing !== null || waypoints.length + added.length > MAX_WAYPOINTS;
    if (!full) setWaypoints(this.store, [...waypoints, ...added]);
    const values = { name, count: added.length, limit: MAX_WAYPOINTS };
    this.store.patch("teaching", { told: t(full ? "teaching.sequence_full" : "teaching.added", values) });
  }

  private async get(name: string): Promise<Plan | null> {
    const { success, message, trajectory } = await ask<MotionResponse>(this.connection, "/teach/get", { name }, WORK_TIMEOUT_S);
    const motion = success && trajectory ? readPlan({ joint_trajectory: trajectory }) : null;
    if (motion === null) this.store.patch("teaching", { told: message });
    return motion;
  }

  /** Replay a motion, at a multiple of the speed in which it was shown. */
  async replay(name: string, speed: number, reverse: boolean): Promise<void> {
    if (this.store.state.teaching.replaying !== null) return;
    this.store.patch("teaching", { replaying: name, told: t("teaching.replaying", { name }) });
    let told = "";
    try {
      const goal = { name, speed, reverse, repeat: 0 };
      this.handle = this.connection.goal<ReplayMotionResult>("/replay_motion", "armbridge_msgs/action/ReplayMotion", goal);
      const { values, reason } = await this.handle.result;
      told = values?.message || reason;
    } catch (error) {
      told = (error as Error).message;
    } finally {
      this.handle = null;
    }
    this.store.patch("teaching", { replaying: null, told });
  }

  /** Stop the replay: the motion brakes along its path. */
  stop(): void {
    this.handle?.cancel();
  }

  private async list(): Promise<void> {
    this.store.patch("teaching", { motions: await askNames(this.connection, "/teach/list") });
  }

  /** Record, keep or change a motion by the service of this name; true when it has done what it was asked for. */
  async work(service: "begin" | "end" | "discard" | "delete" | "rename" | "trim", request: object = {}): Promise<boolean> {
    const { success, message } = await ask<TriggerResponse>(this.connection, `/teach/${service}`, request, WORK_TIMEOUT_S);
    this.store.patch("teaching", { told: message, ...(success ? { edited: null } : {}) });
    await this.list();
    return success;
  }
}
