import type { Orientation, Point, State } from "../state/state";
import { onConnect, type PageStore } from "../state/store";
import type { Connection } from "./connection";
import { checkGoalsRequest, POINT_TOLERANCE_M, valuesByJoint, type GoalCheck } from "./messages";

/** Return a function that sends one request at a time, and after it only the newest of the requests made meanwhile. */
export function latestOnly<Request>(send: (request: Request) => Promise<void>): (request: Request) => void {
  let busy = false;
  let next: { request: Request } | null = null;
  const run = async (): Promise<void> => {
    busy = true;
    while (next) {
      const { request } = next;
      next = null;
      await send(request);
    }
    busy = false;
  };
  return (request) => {
    next = { request };
    if (!busy) void run();
  };
}

/** Time for an answer of /check_goals [s], which takes 5 ms on a quiet machine. */
const CHECK_TIMEOUT_S = 3;

/** Time until a target without an answer is asked about again [ms]: the planner may have been busy. */
const AGAIN_MS = 1000;

type CheckedPose = { position_m: Point; orientation: Orientation | null };

/** Check with the server that the arm can reach each new target; skip targets that are replaced meanwhile. */
export function checkReachability(connection: Connection, store: PageStore): void {
  const check = latestOnly<CheckedPose>(async ({ position_m, orientation }) => {
    try {
      const request = checkGoalsRequest([position_m], orientation);
      const { results } = await connection.call<{ results: GoalCheck[] }>("/check_goals", request, CHECK_TIMEOUT_S);
      if (results[0]) store.set(applyGoalCheck(store.state, position_m, results[0]));
    } catch {
      store.patch("target", { reachable: null });
      setTimeout(checkAgain, AGAIN_MS);
    }
  });
  const checkAgain = (): void => {
    const { link, selection, target: { position_m, orientation } } = store.state;
    if (link.connected && selection.kind === "target" && position_m) check({ position_m, orientation });
  };
  store.subscribe(
    (state) => state.target.position_m,
    (position_m, { target: { orientation } }) => position_m && check({ position_m, orientation }),
  );
  // A restarted server may answer differently.
  onConnect(store, checkAgain);
}

/** Return the changes of the state after a check of a point, which may no longer be the target. */
export function applyGoalCheck(state: State, checked_m: Point, check: GoalCheck): Partial<State> {
  const found = valuesByJoint(check.solution.name, check.solution.position);
  const joints_rad = Object.keys(found).length > 0 ? found : state.target.joints_rad;
  const is_far = check.position_error_m > POINT_TOLERANCE_M;
  const target = {
    ...state.target,
    joints_rad,
    reachable: check.reachable && check.free && !is_far,
    distance_m: Math.max(0, check.position_error_m),
  };
  // During a drag the ghost follows with the solution of the previous point.
  return target.position_m === checked_m || target.dragging ? { target } : {};
}
