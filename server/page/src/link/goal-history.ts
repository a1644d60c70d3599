import { fromServer, joinedPlan } from "../logic/goal-history";
import type { Plan } from "../state/state";
import type { PageStore } from "../state/store";
import { WHILE_CONNECTED_S, type Connection } from "./connection";
import { readGoal, readPlan, type DiagnosticStatus, type RobotTrajectory } from "./messages";

interface GoalRecordResponse {
  success: boolean;
  message: string;
  asked: string;
  summary: string;
  planned: RobotTrajectory[];
  problem_name: string;
  problem: string;
}

/** Record of a goal as the server keeps it. */
export interface GoalRecord extends Omit<GoalRecordResponse, "planned" | "success"> {
  /** The motions one after the other; null without any. */
  plan: Plan | null;
}

/** Ask the server for the goals that were answered before this page was connected. */
export async function fetchGoalHistory(connection: Connection, store: PageStore): Promise<void> {
  const response = await connection.call<{ stamps: number[]; goals: DiagnosticStatus[] }>("/armbridge/goal_history", {}, WHILE_CONNECTED_S);
  const told = response.goals.map((status, index) => {
    const stamp_s = response.stamps[index] ?? 0;
    return { goal: readGoal(status), began_s: stamp_s, stamp_s };
  });
  store.set({ goal_history: fromServer(told, store.state.goal_history) });
}

/** Ask the server for the record of a goal; a text is its reason for having none. */
export async function fetchGoalRecord(connection: Connection, goal_id: string): Promise<GoalRecord | string> {
  try {
    const response = await connection.call<GoalRecordResponse>("/armbridge/goal_record", { goal_id });
    if (!response.success) return response.message;
    const plans = response.planned.map(readPlan).filter((plan) => plan !== null);
    return { ...response, plan: joinedPlan(plans) };
  } catch (error) {
    return (error as Error).message;
  }
}
