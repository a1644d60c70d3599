import type { Point, State } from "./state/state";
import type { PageStore } from "./state/store";
import type { SceneView } from "./view/view";

/** Figures of the drawing. */
interface Drawn {
  frames: number;
  /** Time of the first frame with the arm, from the page's start; 0 before. */
  arm_ms: number;
  /** Stamp of the joint state that is on the screen. */
  joint_stamp_s: number;
  /** Time from the newest joint state to the frame that draws it. */
  age_ms: number;
}

declare global {
  interface Window {
    /** State and figures of the page, for the browser's console and tests. */
    armbridge: {
      state: () => State;
      readonly drawn: Drawn;
      /** Return the place of a point of the root link's frame in the window [px]. */
      screen_of: (...position_m: Point) => [number, number];
    };
  }
}

/** Expose the state and figures of the drawing as `window.armbridge`, read only. */
export function exposeToConsole(store: PageStore, view: SceneView | null): void {
  window.armbridge = {
    state: () => store.state,
    get drawn(): Drawn {
      const figures = view?.figures;
      return {
        frames: figures?.frames ?? 0,
        arm_ms: figures?.arm_drawn_ms ?? 0,
        joint_stamp_s: figures?.drawn_stamp ?? 0,
        age_ms: figures?.age_ms ?? 0,
      };
    },
    screen_of: (...position_m) => view?.screenOf(position_m) ?? [0, 0],
  };
}
