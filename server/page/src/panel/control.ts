import { controlSentence, holder } from "../logic/rights";
import type { State } from "../state/state";
import { button, el, write } from "./dom";
import type { Page } from "./page";

/** Who drives the arm, and how this page comes to. */
export function control({ store, orders, entering }: Page): HTMLElement {
  const words = el("span", { testid: "control", role: "status" });
  const take = button("Take control", "take-control", () => void orders.order("/arm/take_control"));
  const over = button("Take over", "take-over", () => void orders.takeOver(), "Take control from whoever has it");
  const release = button("Release", "release-control", () => void orders.order("/arm/release_control"), "Let others drive");
  const token = button("Token…", "enter-token", () => entering.ask(), "Show the server a token");
  const box = el("div", { class: "control" }, words, take, over, release, token);
  const show = (state: State): void => {
    const who = holder(state);
    const role = state.identity?.role;
    const sentence = controlSentence(state);
    write(words, sentence);
    box.hidden = sentence === "" || !state.link.connected;
    box.dataset["holder"] = who;
    take.hidden = who === "this page" || role === "view" || state.control.policy === "shared";
    take.disabled = who === "another";
    // Nobody without a token takes control from another: that is the server's rule.
    over.hidden = who !== "another" || role !== "admin" || !state.token.held;
    release.hidden = who !== "this page";
    token.hidden = role === undefined || role === "admin";
  };
  for (const part of ["identity", "control", "link", "token"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  return box;
}
