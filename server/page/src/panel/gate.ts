import { hindrance, type Deed } from "../logic/rights";
import type { State } from "../state/state";
import { el } from "./dom";
import type { Page } from "./page";

/** Grey some controls while the server would refuse what they ask for; whatever else greys them does so still. */
export function gated({ store }: Page, deed: Deed, ...controls: HTMLElement[]): HTMLFieldSetElement {
  const gate = el("fieldset", { class: "gate", attributes: { "data-deed": deed } }, ...controls);
  show(gate, store.state);
  return gate;
}

/** Keep every gate of the page as the rights of the moment are. */
export function watchGates({ store }: Page): void {
  // All at once: rows of lists, and their gates, come and go.
  const showAll = (state: State): void => {
    for (const gate of document.querySelectorAll<HTMLFieldSetElement>("fieldset.gate")) show(gate, state);
  };
  for (const part of ["identity", "control"] as const) {
    store.subscribe((state) => state[part], (_, state) => showAll(state));
  }
}

function show(gate: HTMLFieldSetElement, state: State): void {
  const why = hindrance(gate.dataset["deed"] as Deed, state);
  gate.disabled = why !== "";
  gate.title = why;
}
