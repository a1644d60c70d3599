import type { JointValues, Point, State } from "./state";
import type { Store } from "./store";

/** Wish for joints; what was planned for another wish is shown no more. */
export function wish(store: Store<State>, kind: State["wish"]["kind"], joints_rad: JointValues | null, name = ""): void {
  store.set({ wish: { kind, joints_rad, name }, plan: { trajectory: null, tool_path: [], scrub_s: null } });
}

/** Wish for a named pose. */
export function wishNamed(store: Store<State>, name: string): void {
  wish(store, "named", store.state.named[name]?.joints ?? null, name);
}

/** Wish for a point. */
export function wishPoint(store: Store<State>, position_m: Point): void {
  wish(store, "target", null);
  store.patch("target", { position_m });
}
