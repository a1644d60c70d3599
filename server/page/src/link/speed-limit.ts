import { armNamespace } from "../logic/joints";
import type { PageStore } from "../state/store";
import type { Connection } from "./connection";
import { readArmState, type DiagnosticStatus } from "./messages";

/** Keep the speed limit of the planning group's arm; of a group with joints of several arms, the lowest of all arms. */
export function subscribeSpeedLimit(connection: Pick<Connection, "subscribe">, store: PageStore): void {
  // By the namespace of each arm; without one it is told by the state of the arm, or of all arms together.
  const limits = new Map([["", 1]]);
  const take = (namespace: string, limit: number): void => {
    limits.set(namespace, limit);
    store.set({ speed_limit: limits.get(armNamespace(store.state)) ?? 1 });
  };
  store.subscribe((state) => state.arm.speed_limit, (limit) => take("", limit));
  store.subscribe(armNamespace, (namespace) => {
    const known = limits.get(namespace);
    take(namespace, known ?? 1);
    if (known !== undefined) return;
    connection.subscribe<DiagnosticStatus>(`${namespace}/arm/state`, "diagnostic_msgs/DiagnosticStatus", (status) => {
      take(namespace, readArmState(status).speed_limit);
    });
  });
}
