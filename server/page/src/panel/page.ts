import type { Entering } from "../link/entering";
import type { Motions } from "../link/motions";
import type { Orders } from "../link/orders";
import type { Stopping } from "../link/stopping";
import type { State } from "../state/state";
import type { Store } from "../state/store";

/** What every part of the panel has to do with. */
export interface Page {
  store: Store<State>;
  motions: Motions;
  orders: Orders;
  stopping: Stopping;
  entering: Entering;
}
