import type { Orders } from "../link/orders";
import type { State } from "../state/state";
import { wishNamed } from "../state/wishes";
import { button, el, section } from "./dom";
import { gated } from "./gate";
import { orderButtons } from "./order-buttons";
import type { Page } from "./page";
import { speed } from "./speed";

/** Plan, Move, Plan and move, and the named poses. */
export function goals(page: Page): HTMLElement {
  const { store, motions } = page;
  const plan = button("Plan", "plan", () => void motions.plan(), "Plan and show the motion; nothing moves");
  const move = button("Move", "move", () => void motions.move(), "Carry out the motion that is shown");
  const at_once = "Plan the motion and carry it out at once";
  const both = button("Plan and move", "plan-and-move", () => void motions.planAndMove(), at_once);
  both.classList.add("primary");
  const show = ({ link, goal, plan: { trajectory }, wish }: State): void => {
    plan.disabled = both.disabled = !link.connected || wish.kind === "none";
    move.disabled = !link.connected || trajectory === null || goal.state === "executing";
  };
  for (const part of ["link", "goal", "plan", "wish"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  const buttons = el("div", { class: "buttons" }, gated(page, "work", plan), gated(page, "drive", move, both));
  return section("goals", "Motion", true, poses(page), buttons, speed(page), orderButtons(page));
}

function poses(page: Page): HTMLElement {
  const { store, orders } = page;
  const list = el("div", { class: "chips", testid: "named", role: "group", label: "named poses" });
  const choose = (name: string): void => wishNamed(store, name);
  store.subscribe(
    (state) => state.named,
    (named) => {
      const chips = Object.entries(named).map(([name, { saved }]) => {
        const chip = button(name, `named-${name}`, () => choose(name), `Choose the pose “${name}”; nothing moves`);
        if (!saved) return chip;
        const forget = button("×", `delete-${name}`, () => void orders.deletePose(name), `Forget “${name}”`);
        return el("span", { class: "chip-pair" }, chip, gated(page, "configure", forget));
      });
      list.replaceChildren(...chips);
    },
  );
  store.subscribe(
    (state) => state.wish,
    ({ name }) => {
      for (const chip of list.querySelectorAll("button")) {
        chip.setAttribute("aria-pressed", String(name !== undefined && chip.dataset["testid"] === `named-${name}`));
      }
    },
  );
  return el("div", {}, list, gated(page, "configure", saving(orders)));
}

function saving(orders: Orders): HTMLElement {
  const attributes = { placeholder: "name", maxlength: "64", autocomplete: "off" };
  const name = el("input", { type: "text", testid: "save-name", label: "name for the present pose", attributes });
  const save = async (): Promise<void> => {
    const typed = name.value.trim();
    if (typed === "") return name.focus();
    if (await orders.savePose(typed)) name.value = "";
  };
  const press = button("Save present pose", "save", () => void save());
  name.addEventListener("keydown", (event) => event.key === "Enter" && void save());
  return el("div", { class: "line" }, name, press);
}
