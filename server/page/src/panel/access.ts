import { controlHolder, controlText } from "../logic/permissions";
import type { State } from "../state/state";
import type { PanelContext } from "./context";
import { button, el, setText } from "./dom";

/** Create the line about control of the arm, with buttons to take and release it. */
export function controlBar({ store, commands, authentication }: PanelContext): HTMLElement {
  const text = el("span", { testid: "control", role: "status" });
  const take = button("Take control", "take-control", () => void commands.trigger("/arm/take_control"));
  const over = button("Take over", "take-over", () => void commands.takeOver(), "Take control from whoever has it");
  const releaseControl = (): void => void commands.trigger("/arm/release_control");
  const release = button("Release", "release-control", releaseControl, "Let others drive");
  const token = button("Token…", "enter-token", () => authentication.promptForToken(), "Show the server a token");
  const box = el("div", { class: "control" }, text, take, over, release, token);
  const show = (state: State): void => {
    const control_holder = controlHolder(state);
    const role = state.identity?.role;
    const sentence = controlText(state);
    setText(text, sentence);
    box.hidden = sentence === "" || !state.link.connected;
    box.dataset["holder"] = control_holder;
    take.hidden = control_holder === "this page" || role === "view" || state.control.policy === "shared";
    take.disabled = control_holder === "another";
    // The server lets only administrators with a token take over.
    over.hidden = control_holder !== "another" || role !== "admin" || !state.token.held;
    release.hidden = control_holder !== "this page";
    token.hidden = role === undefined || role === "admin";
  };
  for (const part of ["identity", "control", "link", "token"] as const) {
    store.subscribe((state) => state[part], (_, state) => show(state));
  }
  return box;
}

/** Create the prompt for a token; not a modal dialog, which would block STOP. */
export function tokenForm({ store, authentication }: PanelContext): HTMLElement {
  const attributes = { autocomplete: "off", spellcheck: "false", maxlength: "256" };
  const typed = el("input", { type: "password", testid: "token", label: "token", attributes });
  const problem = el("p", { class: "problem", testid: "token-refused", role: "alert" });
  const without = button("Without a token", "without-token", () => authentication.authenticate(null));
  const enter = el("button", { type: "submit", class: "primary", testid: "use-token", text: "Connect" });
  const enterTyped = (event: Event): void => {
    event.preventDefault();
    const token = typed.value.trim();
    typed.value = "";
    if (token === "") typed.focus();
    else authentication.authenticate(token);
  };
  const title = el("b", { text: "A token of this server" });
  const form = el("form", { class: "token", role: "dialog", label: "token", on: { submit: enterTyped } });
  form.append(title, problem, typed, el("div", { class: "buttons" }, enter, without));
  const show = ({ link, token }: State): void => {
    const opened = form.hidden && token.asked;
    form.hidden = !token.asked;
    // Without a token so far the prompt is enough; the server's reason is shown for a wrong one.
    setText(problem, token.held ? link.refused : "");
    if (opened) typed.focus();
  };
  form.hidden = true;
  for (const part of ["link", "token"] as const) store.subscribe((state) => state[part], (_, state) => show(state));
  return form;
}
