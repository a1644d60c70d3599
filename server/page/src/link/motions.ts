import { PREEMPTED, SUCCESS } from "../logic/codes";
import { duration_s } from "../logic/trajectory";
import { noGoal, type Plan, type State } from "../state/state";
import type { Store } from "../state/store";
import type { GoalCall } from "./goal-call";
import type { Link } from "./link";
import * as messages from "./messages";
import { plan as readPlan } from "./parsing";
import type { MotionResult, RobotTrajectory } from "./wire";

/** The motions that the user asks for; every refusal ends in the state as a sentence. */
export class Motions {
  private call: GoalCall<MotionResult> | null = null;
  /** The motions that came last, as the server sent them: they are what Move carries out. */
  private readonly sent = new WeakMap<Plan, RobotTrajectory>();

  /**
   * @param link - to the server.
   * @param store - where answers go.
   */
  constructor(
    private readonly link: Link,
    private readonly store: Store<State>,
  ) {}

  /** Plan what is wished for, and show it. */
  async plan(): Promise<void> {
    const result = await this.moveGroup("plan", true);
    if (result?.error_code.val !== SUCCESS || !result.planned_trajectory) return;
    if (!this.show(result.planned_trajectory)) this.tell(SUCCESS, "the arm is there already");
  }

  /** Show a motion, so that Move carries it out; false when it has no points. */
  show(sent: RobotTrajectory): boolean {
    const trajectory = readPlan(sent);
    if (!trajectory) return false;
    this.sent.set(trajectory, sent);
    const message = `A motion of ${duration_s(trajectory).toFixed(1)} s is planned; Move carries it out.`;
    const { goal } = this.store.state;
    const inHand = ["planning", "executing"].includes(goal.state);
    const shown = inHand ? goal : { ...noGoal(), state: "planned", message };
    this.store.set({ goal: shown, plan: { trajectory, tool_path: [], scrub_s: null } });
    return true;
  }

  /** Carry out the motion that is shown. */
  async move(): Promise<void> {
    const { trajectory } = this.store.state.plan;
    const sent = trajectory && this.sent.get(trajectory);
    if (!sent) return this.tell(null, "There is no plan to carry out: press Plan first.");
    const goal = { trajectory: sent, controller_names: [] };
    await this.ask("move", "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", goal);
  }

  /** Plan what is wished for, and carry it out at once. */
  async planAndMove(): Promise<void> {
    await this.moveGroup("move", false);
  }

  /** Cancel what this page has asked for. */
  cancel(): void {
    this.call?.cancel();
  }

  private async moveGroup(asked: State["asked"], plan_only: boolean): Promise<MotionResult | null> {
    const constraints = messages.wishedGoal(this.store.state);
    if (!constraints) {
      this.tell(null, "Choose first where to go: a named pose, joints, or the target.");
      return null;
    }
    const goal = messages.moveGroupGoal(constraints, this.store.state.settings.speed, plan_only);
    return this.ask(asked, "/move_action", "moveit_msgs/action/MoveGroup", goal);
  }

  private async ask(asked: State["asked"], action: string, type: string, goal: object): Promise<MotionResult | null> {
    let call: GoalCall<MotionResult> | null = null;
    try {
      call = this.link.goal<MotionResult>(action, type, goal);
      this.call = call;
      this.store.set({ asked, goal: noGoal() });
      const { values, reason } = await call.result;
      // One that gave way to a newer one has nothing to say any more.
      if (this.call !== call) return null;
      this.answered(asked, values, reason);
      return values;
    } catch (error) {
      this.tell(null, (error as Error).message);
      return null;
    } finally {
      if (this.call === call) this.finished();
    }
  }

  private finished(): void {
    this.call = null;
    this.store.set({ asked: "nothing" });
  }

  private answered(asked: State["asked"], result: MotionResult | null, reason: string): void {
    const code = result?.error_code;
    if (!code) this.tell(null, reason || "the server gave no result");
    else if (code.val !== SUCCESS) this.tell(code.val, code.message || "the server gave no reason");
    else if (asked === "move") this.tell(code.val, code.message || "the arm is there");
  }

  /** Say how something ended, with what the news of the same goal offered. */
  private tell(code: number | null, message: string): void {
    const { goal } = this.store.state;
    const same = goal.state === "done" && goal.message.startsWith(message) && goal.code !== PREEMPTED;
    const suggestion = same ? goal.suggestion : null;
    this.store.set({ goal: { ...noGoal(), id: goal.id, state: "done", code, message, suggestion } });
  }
}
