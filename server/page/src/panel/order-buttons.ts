import { button, el } from "./dom";
import { gated } from "./gate";
import type { Page } from "./page";

/** The orders that concern the whole arm: to let go, to hold, and to clear a fault. */
export function orderButtons(page: Page): HTMLElement {
  const { store, orders } = page;
  const order = (service: string) => (): void => void orders.order(service);
  const relax = button("Relax", "relax", order("/arm/relax"), "Lower the torque slowly: the arm sinks");
  const hold = button("Hold", "hold", order("/arm/enable"), "Hold where the arm is");
  const reset = button("Reset fault", "reset-fault", order("/arm/reset_fault"), "Clear a fault whose cause is gone");
  store.subscribe(
    (state) => state.arm,
    ({ mode }) => {
      relax.disabled = mode === "relaxed" || mode === "disconnected";
      hold.disabled = mode !== "relaxed";
      reset.disabled = mode !== "fault";
    },
  );
  return el("div", { class: "buttons" }, gated(page, "drive", relax, hold, reset));
}
