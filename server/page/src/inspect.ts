import type { Point, State } from "./state/state";
import type { PageStore } from "./state/store";
import { NO_FRAMES, type FrameFigures, type SceneView } from "./view/view";

declare global {
  interface Window {
    /** State and figures of the page, for the browser's console and tests. */
    armbridge: {
      state: () => State;
      readonly drawn: FrameFigures;
      /** Return the place of a point of the root link's frame in the window [px]. */
      screen_of: (...position_m: Point) => [number, number];
    };
  }
}

/** Expose the state and figures of the drawing as `window.armbridge`, read only. */
export function exposeToConsole(store: PageStore, view: SceneView | null): void {
  window.armbridge = {
    state: () => store.state,
    get drawn() {
      return view?.figures ?? NO_FRAMES;
    },
    screen_of: (...position_m) => view?.viewer.screenOf(position_m) ?? [0, 0],
  };
}
