import { present } from "../logic/joint-names";
import { duration_s, samplePlan } from "../logic/trajectory";
import type { Plan, State } from "../state/state";
import type { Store } from "../state/store";

import type { Link } from "./link";
import type { Motions } from "./motions";
import { plan as readPlan } from "./parsing";
import type { RobotTrajectory } from "./wire";

/** A motion from farther away than this is refused by the server [rad]. */
const START_RAD = 0.05;

/** Show the plans of other pages and clients too, those that Move could carry out from here. */
export function showPlans(link: Link, store: Store<State>, motions: Motions): void {
  let waiting: RobotTrajectory | null = null;
  const take = (): void => {
    if (!waiting || store.state.joints.names.length === 0) return;
    const shown = readPlan(waiting);
    if (store.state.asked !== "plan" && shown && startsHere(shown, store.state)) motions.show(waiting);
    waiting = null;
  };
  link.subscribe<{ trajectory: RobotTrajectory[] }>("/display_planned_path", "moveit_msgs/DisplayTrajectory", (message) => {
    // Several are a sequence, which Move cannot carry out.
    waiting = message.trajectory.length === 1 ? (message.trajectory[0] ?? null) : null;
    take();
  });
  // The latched plan comes before the first joint state.
  store.subscribe((state) => state.joints, take);
}

/** Whether a motion begins where the arm stands, and leads away from there. */
export function startsHere(plan: Plan, state: Pick<State, "joints" | "arm">): boolean {
  if (state.arm.mode === "moving") return false;
  const here = present(state);
  const far = (time_s: number): number => {
    const there = samplePlan(plan, time_s);
    return Math.max(0, ...Object.entries(there).map(([name, value]) => Math.abs(value - (here[name] ?? Infinity))));
  };
  return far(0) <= START_RAD && far(duration_s(plan)) > START_RAD;
}
