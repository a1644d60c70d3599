import type { State } from "../state/state";
import type { Store } from "../state/store";

/** The page's store. */
export type PageStore = Store<State>;

/** One thing that the view shows; before each frame it is brought up to date with the state. */
export interface Part {
  /** Takes over what is new; what is as before costs nothing. */
  update(state: State): void;
}
