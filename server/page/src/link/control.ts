import type { State } from "../state/state";
import type { Store } from "../state/store";
import type { Link } from "./link";
import * as parsing from "./parsing";
import type { DiagnosticStatus, Trigger } from "./wire";

/** Hear who drives the arm, and learn after every connection who this page is. */
export function hearControl(link: Link, store: Store<State>): void {
  link.subscribe<DiagnosticStatus>("/arm/control", "diagnostic_msgs/DiagnosticStatus", (status) => {
    store.set({ control: parsing.control(status) });
  });
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      // Another connection has another address.
      store.set({ identity: null });
      if (connected) void askWhoIAm(link, store);
    },
  );
}

async function askWhoIAm(link: Link, store: Store<State>): Promise<void> {
  try {
    const { message } = await link.call<Trigger>("/arm/who_am_i", {});
    store.set({ identity: parsing.identity(message) });
  } catch {
    // Then nothing is greyed, and the server says itself what it refuses.
  }
}
