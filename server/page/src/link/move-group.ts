import { currentPositions } from "../logic/joints";
import { planningGroup } from "../logic/robot-info";
import { duration_s, samplePlan } from "../logic/trajectory";
import { NO_GOAL, NO_PLAN, type JointValues, type PendingRequest, type Plan, type State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Connection, GoalHandle } from "./connection";
import { goalConstraints, jointConstraints, moveGroupGoal, PREEMPTED, readPlan, SUCCESS, type MotionResult, type RobotTrajectory } from "./messages";
import { isCheckingLegs } from "./sequence";

/** Client of MoveIt's actions; every rejection becomes the message of the shown goal. */
export class MoveGroupClient {
  private handle: GoalHandle<MotionResult> | null = null;
  /** Trajectories of the shown plans as the server sent them, which are those to execute. */
  private readonly sent_trajectories = new WeakMap<Plan, RobotTrajectory>();

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {}

  async plan(): Promise<void> {
    const result = await this.sendSelection("plan");
    if (result?.error_code.val !== SUCCESS || !result.planned_trajectory) return;
    if (!this.showPlan(result.planned_trajectory)) this.report(SUCCESS, t("answer.there_already"));
  }

  /** Show a trajectory, which execute() then sends; return false when it has no points. */
  showPlan(sent: RobotTrajectory): boolean {
    const trajectory = readPlan(sent);
    if (!trajectory) return false;
    this.sent_trajectories.set(trajectory, sent);
    const message = t("answer.planned", { seconds: duration_s(trajectory).toFixed(1) });
    const { goal } = this.store.state;
    // A goal with an id is the server's, and tells of itself.
    const in_progress = ["planning", "executing"].includes(goal.state) || (goal.state === "planned" && goal.id !== "");
    const shown = in_progress ? goal : { ...NO_GOAL, state: "planned", message };
    this.store.set({ goal: shown, plan: { ...NO_PLAN, trajectory, executable: true } });
    return true;
  }

  async execute(): Promise<void> {
    const { trajectory } = this.store.state.plan;
    const sent = trajectory && this.sent_trajectories.get(trajectory);
    if (!sent) return this.report(null, t("answer.no_plan"));
    const goal = { trajectory: sent, controller_names: [] };
    await this.sendGoal("move", "/execute_trajectory", "moveit_msgs/action/ExecuteTrajectory", goal);
  }

  async planAndExecute(): Promise<void> {
    await this.sendSelection("move");
  }

  /** Move to joint values at once, in place of a motion in progress, at a fraction of the speed limits. */
  async moveTo(joints_rad: JointValues, speed: number): Promise<void> {
    await this.sendConstraints("move", jointConstraints(joints_rad), speed);
  }

  cancel(): void {
    this.handle?.cancel();
  }

  private async sendSelection(request: PendingRequest): Promise<MotionResult | null> {
    const constraints = goalConstraints(this.store.state);
    if (constraints) return this.sendConstraints(request, constraints, this.store.state.settings.speed);
    this.report(null, t("answer.no_goal"));
    return null;
  }

  private sendConstraints(request: PendingRequest, constraints: object, speed: number): Promise<MotionResult | null> {
    const { group } = this.store.state;
    // Before the server has told a group, it knows its own default best.
    const group_name = group && (planningGroup(this.store.state)?.name ?? "");
    const goal = moveGroupGoal(constraints, speed, request === "plan", group_name);
    return this.sendGoal(request, "/move_action", "moveit_msgs/action/MoveGroup", goal);
  }

  private async sendGoal(
    pending_request: PendingRequest,
    action: string,
    type: string,
    goal: object,
  ): Promise<MotionResult | null> {
    let handle: GoalHandle<MotionResult> | null = null;
    try {
      handle = this.connection.goal<MotionResult>(action, type, goal);
      this.handle = handle;
      this.store.set({ pending_request, goal: NO_GOAL });
      const { values, reason } = await handle.result;
      // The result of a goal that a newer one has replaced must not hide that of the newer one.
      if (this.handle !== handle) return null;
      this.reportResult(pending_request, values, reason);
      return values;
    } catch (error) {
      this.report(null, (error as Error).message);
      return null;
    } finally {
      if (this.handle === handle) {
        this.handle = null;
        this.store.set({ pending_request: "nothing" });
      }
    }
  }

  private reportResult(pending_request: PendingRequest, result: MotionResult | null, reason: string): void {
    const code = result?.error_code;
    if (!code) this.report(null, reason || t("answer.no_result"));
    else if (code.val !== SUCCESS) this.report(code.val, code.message || t("answer.no_reason"));
    else if (pending_request === "move") this.report(code.val, code.message || t("answer.there"));
  }

  /** Show a result, with the suggestion that the status of the same goal contained. */
  private report(code: number | null, message: string): void {
    const { goal } = this.store.state;
    const same = goal.state === "done" && goal.message.startsWith(message) && goal.code !== PREEMPTED;
    const suggestion = same ? goal.suggestion : null;
    this.store.set({ goal: { ...NO_GOAL, id: goal.id, state: "done", code, message, suggestion } });
  }
}

/** Distance of the start of a trajectory from the arm beyond which the server rejects it [rad]. */
const START_TOLERANCE_RAD = 0.05;

/** Show also the plans of other clients, where they start at the current state and so can be executed. */
export function subscribeDisplayedPlans(connection: Connection, store: PageStore, moveGroup: MoveGroupClient): void {
  let pending: RobotTrajectory | null = null;
  const show = (): void => {
    if (!pending || store.state.joints.names.length === 0) return;
    const plan = readPlan(pending);
    const is_planning = store.state.pending_request === "plan";
    if (!is_planning && plan && startsAtCurrentState(plan, store.state)) moveGroup.showPlan(pending);
    pending = null;
  };
  connection.subscribe("/display_planned_path", "moveit_msgs/msg/DisplayTrajectory", ({ trajectory }) => {
    // The leg of a sequence that is being checked was not asked for to be carried out.
    if (isCheckingLegs(store.state)) return;
    // Several trajectories are a sequence, which ExecuteTrajectory cannot take.
    pending = trajectory.length === 1 ? (trajectory[0] ?? null) : null;
    show();
  });
  // The latched plan comes before the first joint state.
  store.subscribe((state) => state.joints, show);
  store.subscribe((state) => state.joints, () => dropStalePlan(store));
}

/** Drop a plan that starts elsewhere, after the arm has been driven away from its start or moved by hand. */
function dropStalePlan(store: PageStore): void {
  const { plan, goal, pending_request, joints } = store.state;
  if (plan.trajectory === null || !plan.executable || joints.names.length === 0) return;
  const in_progress = pending_request === "move" || ["queued", "planning", "executing"].includes(goal.state);
  if (!in_progress && distanceAt(plan.trajectory, 0, store.state) > START_TOLERANCE_RAD) store.set({ plan: NO_PLAN });
}

/** Return the longest way of a joint from where the arm is to a plan at one of its times [rad or m]. */
function distanceAt(plan: Plan, time_s: number, state: Pick<State, "joints">): number {
  const current = currentPositions(state);
  const planned = Object.entries(samplePlan(plan, time_s));
  return Math.max(0, ...planned.map(([name, value]) => Math.abs(value - (current[name] ?? Infinity))));
}

/** Return true when a plan starts at the arm's current state, and ends elsewhere. */
export function startsAtCurrentState(plan: Plan, state: Pick<State, "joints" | "arm">): boolean {
  if (state.arm.mode === "moving") return false;
  return distanceAt(plan, 0, state) <= START_TOLERANCE_RAD && distanceAt(plan, duration_s(plan), state) > START_TOLERANCE_RAD;
}
