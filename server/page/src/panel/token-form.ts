import type { State } from "../state/state";
import { button, el, write } from "./dom";
import type { Page } from "./page";

/** Asks for a token; no modal dialog, which would keep STOP from being pressed. */
export function tokenForm({ store, entering }: Page): HTMLElement {
  const attributes = { autocomplete: "off", spellcheck: "false", maxlength: "256" };
  const typed = el("input", { type: "password", testid: "token", label: "token", attributes });
  const why = el("p", { class: "problem", testid: "token-refused", role: "alert" });
  const without = button("Without a token", "without-token", () => entering.enter(null));
  const enter = el("button", { type: "submit", class: "primary", testid: "use-token", text: "Connect" });
  const enterTyped = (event: Event): void => {
    event.preventDefault();
    const token = typed.value.trim();
    typed.value = "";
    if (token === "") typed.focus();
    else entering.enter(token);
  };
  const title = el("b", { text: "A token of this server" });
  const form = el("form", { class: "token", role: "dialog", label: "token", on: { submit: enterTyped } });
  form.append(title, why, typed, el("div", { class: "buttons" }, enter, without));
  const show = ({ link, token }: State): void => {
    const opened = form.hidden && token.asked;
    form.hidden = !token.asked;
    // A page that never had one is not told that it is missing: it is asked for it.
    write(why, token.held ? link.refused : "");
    if (opened) typed.focus();
  };
  form.hidden = true;
  for (const part of ["link", "token"] as const) store.subscribe((state) => state[part], (_, state) => show(state));
  return form;
}
