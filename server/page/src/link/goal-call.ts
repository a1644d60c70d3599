import type { Ros } from "roslib";

/** What action_msgs/GoalStatus calls a goal that failed. */
export const ABORTED = 6;

/** A goal that was sent to an action. */
export interface GoalCall<Result> {
  /** The end: its status as in action_msgs/GoalStatus, and the result or, of a goal that was not taken, the reason. */
  result: Promise<{ status: number; values: Result | null; reason: string }>;
  /** Ask the server to cancel it. */
  cancel: () => void;
}

interface ActionResult {
  op: string;
  status: number;
  result: boolean;
  values: unknown;
}

let sent = 0;

/** Send a goal by rosbridge's own operations: roslib's Action turns the result of a failed goal into a text. */
export function sendGoal<Result>(ros: Ros, action: string, type: string, goal: unknown): GoalCall<Result> {
  sent += 1;
  const id = `send_action_goal:${action}:${sent}`;
  const result = new Promise<Awaited<GoalCall<Result>["result"]>>((resolve) => {
    const hear = (message: unknown): void => {
      const answer = message as ActionResult;
      if (answer.op !== "action_result") return;
      ros.off(id, hear);
      const readable = typeof answer.values === "object" && answer.values !== null;
      const values = readable ? (answer.values as Result) : null;
      resolve({ status: answer.status, values, reason: readable ? "" : String(answer.values ?? "") });
    };
    ros.on(id, hear);
  });
  ros.callOnConnection({ op: "send_action_goal", id, action, action_type: type, args: goal, feedback: false });
  const cancel = (): void => {
    if (ros.isConnected) ros.callOnConnection({ op: "cancel_action_goal", id, action });
  };
  return { result, cancel };
}
