import type { Point, State } from "../state/state";
import type { Store } from "../state/store";
import type { Link } from "./link";
import { checkPoint } from "./messages";
import { Newest } from "./newest";
import { byName } from "./parsing";
import type { GoalCheck } from "./wire";

/** An answer takes 5 ms; more than this is a server that is gone. */
const PATIENCE_S = 3;

/** How far from a point the tip may be for the point to count as reached [m]; what /moveit_goal_pose takes. */
const NEAR_M = 0.01;

/** Ask for every new target whether the arm can be there, the newest first. */
export function checkTargets(link: Link, store: Store<State>): void {
  const newest = new Newest<Point>(async (position_m) => {
    if (!link.isConnected) return;
    try {
      const { results } = await link.call<{ results: GoalCheck[] }>("/check_goals", checkPoint(position_m), PATIENCE_S);
      if (results[0]) store.set(afterCheck(store.state, position_m, results[0]));
    } catch {
      store.patch("target", { reachable: null });
    }
  });
  store.subscribe(
    (state) => state.target.position_m,
    (position_m) => position_m && newest.put(position_m),
  );
  // Nobody has answered while the server was away, and another may think otherwise.
  store.subscribe(
    (state) => state.link.connected,
    (connected, { wish, target: { position_m } }) => {
      if (connected && wish.kind === "target" && position_m) newest.put(position_m);
    },
  );
}

/** What is shown after an answer about a point, perhaps no more the newest. */
export function afterCheck(state: State, asked_m: Point, check: GoalCheck): Partial<State> {
  const found = byName(check.solution.name, check.solution.position);
  const joints_rad = Object.keys(found).length > 0 ? found : state.target.joints_rad;
  const far = check.position_error_m > NEAR_M;
  const target = {
    ...state.target,
    joints_rad,
    reachable: check.reachable && check.free && !far,
    distance_m: Math.max(0, check.position_error_m),
  };
  // While it is dragged the ghost follows with what was found for the point just left.
  return target.position_m === asked_m || target.dragging ? { target } : {};
}
