import type { WaitingGoal } from "../state/state";
import { button, el, section } from "./dom";
import type { Page } from "./page";

/** The goals that are worked on or wait, whoever sent them. */
export function waiting({ store, stopping, orders }: Page): HTMLElement {
  const list = el("ol", { class: "things", testid: "waiting" });
  const all = button("Cancel all", "cancel-all", () => void stopping.stop(), "Stop, and end all goals");
  const box = section("waiting", "Goals in hand and waiting", false, list, all);
  store.subscribe(
    (state) => state.waiting,
    (goals) => {
      list.replaceChildren(...goals.map((goal) => line(goal, () => orders.cancelGoal(goal.id))));
      all.disabled = goals.length === 0;
    },
  );
  return box;
}

function line({ id, name, state }: WaitingGoal, cancel: () => void): HTMLElement {
  const text = el("span", { text: `${name} #${id}: ${state}` });
  return el("li", { testid: `waiting-${id}` }, text, button("Cancel", `cancel-${id}`, cancel));
}
