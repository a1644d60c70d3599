import { controlHolder, controlText } from "../logic/permissions";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { button, el, setText } from "./dom";

/** Create the line about control of the arm, with buttons to take and release it. */
export function controlBar({ store, commands, authentication }: PanelContext): HTMLElement {
  const text = el("span", { testid: "control", role: "status" });
  const take = button(t("control.take"), "take-control", () => void commands.trigger("/arm/take_control"), t("control.take.title"));
  const over = button(t("control.over"), "take-over", () => void commands.takeOver(), t("control.over.title"));
  const releaseControl = (): void => void commands.trigger("/arm/release_control");
  const release = button(t("control.release"), "release-control", releaseControl, t("control.release.title"));
  const token = button(t("control.token"), "enter-token", () => authentication.promptForToken(), t("control.token.title"));
  const box = el("div", { class: "control" }, text, take, over, release, token);
  const show = (state: State): void => {
    const control_holder = controlHolder(state);
    const role = state.identity?.role;
    const sentence = controlText(state);
    setText(text, sentence);
    text.title = sentence;
    box.hidden = sentence === "" || !state.link.connected;
    box.dataset["holder"] = control_holder;
    take.hidden = control_holder === "mine" || role === "view" || role === "propose" || state.control.policy === "shared";
    take.disabled = control_holder === "another";
    // The server lets only administrators with a token take over.
    over.hidden = control_holder !== "another" || role !== "admin" || !state.token.held;
    release.hidden = control_holder !== "mine";
    token.hidden = role === undefined || role === "admin";
  };
  store.watch(["identity", "control", "link", "token"], show);
  return box;
}

/** Create the prompt for a token; not a modal dialog, which would block STOP. */
export function tokenForm({ store, authentication }: PanelContext): HTMLElement {
  const attributes = { autocomplete: "off", spellcheck: "false", maxlength: "256" };
  const typed = el("input", { type: "password", testid: "token", label: t("token.field"), attributes });
  const problem = el("p", { class: "problem", testid: "token-refused", role: "alert" });
  const without = button(t("token.without"), "without-token", () => authentication.authenticate(null));
  const enter = el("button", { type: "submit", class: "primary", testid: "use-token", text: t("token.connect") });
  const enterTyped = (event: Event): void => {
    event.preventDefault();
    const token = typed.value.trim();
    typed.value = "";
    if (token === "") typed.focus();
    else authentication.authenticate(token);
  };
  const title = el("b", { text: t("token.title") });
  const form = el("form", { class: "token", role: "dialog", label: t("token.field"), on: { submit: enterTyped } });
  form.append(title, problem, typed, el("div", { class: "buttons" }, enter, without));
  const show = ({ link, token }: State): void => {
    const opened = form.hidden && token.asked;
    form.hidden = !token.asked;
    // Without a token so far the prompt is enough; the server's reason is shown for a wrong one.
    setText(problem, token.held ? link.refused : "");
    if (opened) typed.focus();
  };
  form.hidden = true;
  store.watch(["link", "token"], show);
  return form;
}
