import type { Point, State } from "./state/state";
import type { Store } from "./state/store";
import type { View } from "./view/view";

/** What was drawn. */
interface Drawn {
  frames: number;
  /** When the arm was first drawn, from the page's start; 0 before. */
  arm_ms: number;
  /** Stamp of the joint state that is on the screen. */
  joint_stamp_s: number;
  /** From the newest joint state to the frame that draws it. */
  age_ms: number;
}

declare global {
  interface Window {
    /** What the page knows and has drawn, to look at from the browser's console. */
    armbridge: {
      state: () => State;
      readonly drawn: Drawn;
      /** Where a point of the root link's frame is in the window [px]. */
      screen_of: (...position_m: Point) => [number, number];
    };
  }
}

/** Let state and figures be looked at from outside; nothing can be changed there. */
export function inspectable(store: Store<State>, view: View | null): void {
  window.armbridge = {
    state: () => store.state,
    get drawn(): Drawn {
      const stats = view?.stats();
      return {
        frames: stats?.frames ?? 0,
        arm_ms: stats?.arm_drawn_ms ?? 0,
        joint_stamp_s: stats?.drawn_stamp ?? 0,
        age_ms: stats?.age_ms ?? 0,
      };
    },
    screen_of: (...position_m) => view?.screenOf(position_m) ?? [0, 0],
  };
}
