import { armGripper, armJoints, currentPositions } from "../logic/joints";
import { legRequest, sequenceSteps, type LegCheck, type Step, type Waypoint } from "../logic/sequence";
import { duration_s } from "../logic/trajectory";
import type { JointValues, State } from "../state/state";
import type { PageStore } from "../state/store";
import { t } from "../texts/texts";
import type { Connection, GoalHandle } from "./connection";
import { readPlan, SUCCESS, type CheckMotionResponse, type GetMotionPlanResponse, type MotionResult } from "./messages";

/** Time for the plan of a leg [s]: planners give up after allowed_planning_time, 5 s unless it is set. */
const PLAN_TIMEOUT_S = 20;

/** Least time of a round of a sequence that is repeated [ms]. */
const MIN_ROUND_MS = 1000;

/** Time without an edit after which the legs are checked [ms]. */
const CHECK_DELAY_MS = 300;

/** Steps of joint values that count as the same start of a leg [rad or m]: an arm at rest droops less. */
const START_STEP = 0.02;

const STATUS_SUCCEEDED = 4;

const CHECKING: LegCheck = { verdict: "checking", message: "", duration_s: 0, end_rad: null, plan: null };

/** Checks the legs of the sequence while it is edited, and plays it. */
export class SequencePlayer {
  /** Answers by what was asked; emptied when objects of the scene change. */
  private readonly answers = new Map<string, LegCheck>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  /** Number of the present check: an older one ends when it sees another. */
  private check_number = 0;
  private handle: GoalHandle<MotionResult> | null = null;
  private endPause: () => void = () => undefined;
  private stopped = false;

  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    store.subscribe((state) => state.sequence.waypoints, () => this.checkSoon());
    store.subscribe(({ arm, link, sequence }) => `${arm.mode} ${link.connected} ${sequence.playing === null}`, () => this.checkSoon());
    store.subscribe((state) => state.objects, () => {
      this.answers.clear();
      this.checkSoon();
    });
    // Anyone's stop: while the sequence waits, no goal ends that would tell of it.
    store.subscribe((state) => state.arm.last_stop, () => this.stop());
    store.subscribe(
      (state) => state.stop.phase,
      (phase) => phase === "asked" && this.stop(),
    );
  }

  /** Play the sequence from its start, after a check of all of it. */
  async play(): Promise<void> {
    if (this.store.state.sequence.playing !== null) return;
    this.stopped = false;
    const { waypoints } = this.store.state.sequence;
    this.store.patch("sequence", { playing: { index: 0, doing: "check" }, result: "" });
    const refusal = await this.refusalOf(waypoints);
    let result = refusal ?? "";
    while (refusal === null && result === "") {
      const began_ms = performance.now();
      result = (await this.playOnce(waypoints)) ?? "";
      if (result === "" && !this.store.state.sequence.loop) result = t("sequence.done", { count: waypoints.length });
      // An arm that is everywhere already must not be asked without end.
      const rest_ms = MIN_ROUND_MS - (performance.now() - began_ms);
      if (result === "" && rest_ms > 0) await this.pause(rest_ms);
    }
    this.store.patch("sequence", { result, playing: null });
  }

  /** Stop the sequence: the motion brakes along its path, and nothing more begins. */
  stop(): void {
    this.stopped = true;
    this.handle?.cancel();
    this.endPause();
  }

  /** Check all waypoints; return the reason against playing them as a sentence, null for none. */
  private async refusalOf(waypoints: readonly Waypoint[]): Promise<string | null> {
    const checks = await this.checkLegs(waypoints);
    const refused = checks.findIndex(({ verdict }) => verdict === "refused");
    if (refused < 0) return null;
    const { name = "" } = waypoints[refused] ?? {};
    return t("sequence.refused", { name, message: checks[refused]?.message ?? "" });
  }

  /** Play waypoints once; return the reason for an end before the last one as a sentence, null for none. */
  private async playOnce(waypoints: readonly Waypoint[]): Promise<string | null> {
    for (const step of sequenceSteps(waypoints, armGripper(this.store.state)?.action ?? null)) {
      if (this.stopped) break;
      this.store.patch("sequence", { playing: { index: step.index, doing: step.doing } });
      const problem = await this.carryOut(step);
      if (this.stopped) break;
      const { name = "" } = waypoints[step.index] ?? {};
      if (problem !== "") return t("sequence.failed", { name, message: problem });
    }
    return this.stopped ? t("sequence.stopped") : null;
  }

  private pause(time_ms: number): Promise<void> {
    return new Promise<void>((resolve) => {
      const timer = setTimeout(resolve, time_ms);
      this.endPause = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }

  /** Carry out a step; return the reason for a failure, empty for none. */
  private async carryOut(step: Step): Promise<string> {
    if (step.doing === "pause") {
      await this.pause(step.pause_s * 1000);
      return "";
    }
    try {
      this.handle = this.connection.goal<MotionResult>(step.action, step.type, step.goal);
      const { status, values, reason } = await this.handle.result;
      if (status === STATUS_SUCCEEDED) return "";
      return values?.error_code?.message || reason || t("sequence.no_reason");
    } catch (error) {
      return (error as Error).message;
    } finally {
      this.handle = null;
    }
  }

  private checkSoon(): void {
    clearTimeout(this.timer);
    const { sequence, arm, link } = this.store.state;
    const can_check = sequence.playing === null && arm.mode !== "moving" && link.connected;
    if (can_check) this.timer = setTimeout(() => void this.checkLegs(sequence.waypoints), CHECK_DELAY_MS);
  }

  /** Ask the server for each leg, begun where the one before ends. */
  private async checkLegs(waypoints: readonly Waypoint[]): Promise<LegCheck[]> {
    const number = ++this.check_number;
    const checks: LegCheck[] = waypoints.map(() => CHECKING);
    let start_rad = presentStart(this.store.state);
    for (const [index, waypoint] of waypoints.entries()) {
      const onAsk = (): void => this.store.patch("sequence", { checks: [...checks] });
      const check = await this.checkLeg(waypoint, start_rad, index === 0, onAsk);
      if (number !== this.check_number || waypoints !== this.store.state.sequence.waypoints) return checks;
      checks[index] = check;
      this.store.patch("sequence", { checks: [...checks] });
      start_rad = check.end_rad ?? waypoint.joints_rad;
    }
    return checks;
  }

  /** Return the answer that is known for a leg, or ask for it, which `onAsk` is told first. */
  private async checkLeg(waypoint: Waypoint, start_rad: JointValues, is_first: boolean, onAsk: () => void): Promise<LegCheck> {
    const { joints_rad, motion, group, straight, speed } = waypoint;
    const steps = Object.values(start_rad).map((value) => Math.round(value / START_STEP));
    const key = JSON.stringify([joints_rad, motion, group, straight, speed, steps, is_first]);
    const known = this.answers.get(key);
    if (known) return known;
    onAsk();
    try {
      const to_start = { ...waypoint, joints_rad: motion?.start_rad ?? joints_rad, straight: motion === null && straight };
      const request = { motion_plan_request: legRequest(to_start, start_rad) };
      const response = await this.connection.call<GetMotionPlanResponse>("/plan_kinematic_path", request, PLAN_TIMEOUT_S);
      let check = readCheck(response.motion_plan_response, is_first);
      if (motion !== null && check.verdict === "possible") check = await this.checkReplay(waypoint, motion.name, check.duration_s);
      // Edits of an hour must not be kept for ever.
      if (this.answers.size >= MAX_ANSWERS) this.answers.clear();
      this.answers.set(key, check);
      return check;
    } catch (error) {
      return { ...CHECKING, verdict: "unknown", message: (error as Error).message };
    }
  }

  /** Ask for the replay of a taught motion, once the arm has reached its start. */
  private async checkReplay({ speed, joints_rad }: Waypoint, name: string, before_s: number): Promise<LegCheck> {
    const { success, message, duration_s } = await this.connection.call<CheckMotionResponse>("/teach/check", { name, speed }, PLAN_TIMEOUT_S);
    if (!success) return { ...CHECKING, verdict: "refused", message };
    return { verdict: "possible", message: "", duration_s: before_s + duration_s, end_rad: joints_rad, plan: null };
  }
}

/** Largest number of answers that are kept, a few edits of the longest sequence. */
const MAX_ANSWERS = 500;

/** START_STATE_IN_COLLISION and START_STATE_INVALID of moveit_msgs/MoveItErrorCodes. */
const BAD_START = [-10, -26];

function readCheck({ error_code, trajectory }: GetMotionPlanResponse["motion_plan_response"], is_first: boolean): LegCheck {
  const { val, message } = error_code;
  // The leg itself is not to blame: it would begin at a waypoint where the arm cannot be.
  if (!is_first && BAD_START.includes(val)) return { ...CHECKING, verdict: "unknown", message: t("sequence.bad_start") };
  if (val !== SUCCESS) return { ...CHECKING, verdict: "refused", message };
  // An arm that is there already gets a trajectory without points.
  const plan = readPlan(trajectory);
  const last = plan?.points.at(-1);
  const values = plan?.names.map((name, index) => [name, last?.position_rad[index] ?? 0] as const);
  return {
    verdict: "possible",
    message,
    duration_s: plan ? duration_s(plan) : 0,
    end_rad: values ? Object.fromEntries(values) : null,
    plan,
  };
}

/** Return the measured positions of the arm's joints, without the gripper's. */
function presentStart(state: State): JointValues {
  const names = armJoints(state);
  return Object.fromEntries(Object.entries(currentPositions(state)).filter(([name]) => names.includes(name)));
}

/** Return true while the server is asked for a leg, which it also tells all viewers as a plan. */
export function isCheckingLegs({ sequence }: Pick<State, "sequence">): boolean {
  return sequence.checks.some(({ verdict }) => verdict === "checking");
}

/** Replace the waypoints of the sequence; legs between two unchanged waypoints keep their answer. */
export function setWaypoints(store: PageStore, waypoints: readonly Waypoint[]): void {
  const { sequence } = store.state;
  if (sequence.playing !== null) return;
  const before = sequence.waypoints;
  const checks = waypoints.map((waypoint, index) => {
    const at = before.indexOf(waypoint);
    const unchanged = at >= 0 && before[at - 1] === waypoints[index - 1];
    return (unchanged && sequence.checks[at]) || CHECKING;
  });
  store.patch("sequence", { waypoints, checks, result: "" });
}
