import { HandObserver } from "../logic/commissioning";
import { setNotice, type PageStore } from "../state/store";
import { ask, type Connection } from "./connection";
import { readCommissioning, type TriggerResponse } from "./messages";

/** Least time between two drawn states [ms]; bars that move faster cannot be read. */
const UPDATE_PERIOD_MS = 100;

/** Time for an answer of the server [s]: before a procedure begins, the arm stops and the torque goes off. */
const ANSWER_TIMEOUT_S = 15;

/** Subscribe to the state of calibration and verification; the topic is latched, so a new page knows it at once. */
export function subscribeCommissioning(connection: Connection, store: PageStore): void {
  const hand = new HandObserver();
  connection.subscribe("/arm/commissioning/state", "armbridge_msgs/msg/CommissioningState", (message) => {
    const commissioning = readCommissioning(message);
    store.set({ commissioning, joint_in_hand: nextInHand(store, hand.observe(commissioning, store.state.joints)) });
  }, UPDATE_PERIOD_MS);
}

/** Return the joint in hand; the very object of the state where it is the same, so that nobody is told again. */
function nextInHand(store: PageStore, next: ReturnType<HandObserver["observe"]>): typeof next {
  const before = store.state.joint_in_hand;
  return next?.joint === before?.joint && next?.direction === before?.direction ? before : next;
}

/** Requests to calibrate and verify; every refusal becomes a notice. */
export class CommissioningCommands {
  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {}

  /** Begin a procedure (with an empty name the calibration in use is written), answer a step, or break off. */
  async request(service: "begin" | "answer" | "cancel", request: object = {}): Promise<boolean> {
    const { success, message } = await ask<TriggerResponse>(this.connection, `/arm/commissioning/${service}`, request, ANSWER_TIMEOUT_S);
    setNotice(this.store, "commissioning", success ? "" : message);
    return success;
  }
}
