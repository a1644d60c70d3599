import { HandObserver } from "../logic/commissioning";
import { setNotice, type PageStore } from "../state/store";
import { ask, type Connection } from "./connection";
import { readCommissioning, type CommissioningMessage, type TriggerResponse } from "./messages";

/** Least time between two drawn states [ms]; bars that move faster cannot be read. */
const UPDATE_PERIOD_MS = 100;

/** Time for an answer of the server [s]: before a procedure begins, the arm stops and the torque goes off. */
const ANSWER_TIMEOUT_S = 15;

/** Key of the notice with the server's refusal. */
const NOTICE = "commissioning";

/** Subscribe to the state of calibration and verification; the topic is latched, so a new page knows it at once. */
export function subscribeCommissioning(connection: Connection, store: PageStore): void {
  const hand = new HandObserver();
  const listener = (message: CommissioningMessage): void => {
    const commissioning = readCommissioning(message);
    store.set({ commissioning, joint_in_hand: nextInHand(store, hand.observe(commissioning, store.state.joints)) });
  };
  const type = "armbridge_msgs/msg/CommissioningState";
  connection.subscribe<CommissioningMessage>("/arm/commissioning/state", type, listener, UPDATE_PERIOD_MS);
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

  /** Begin a procedure; an empty name writes the calibration in use. */
  async begin(procedure: "calibrate" | "verify", name: string): Promise<boolean> {
    return this.request("/arm/commissioning/begin", { procedure, name });
  }

  /** Answer a step; the server refuses an answer to a step that is over. */
  async answer(step: string, answer: string): Promise<boolean> {
    return this.request("/arm/commissioning/answer", { step, answer });
  }

  /** Break the procedure off. */
  async cancel(): Promise<boolean> {
    return this.request("/arm/commissioning/cancel", {});
  }

  private async request(service: string, request: object): Promise<boolean> {
    const { success, message } = await ask<TriggerResponse>(this.connection, service, request, ANSWER_TIMEOUT_S);
    setNotice(this.store, NOTICE, success ? "" : message);
    return success;
  }
}
