import type { JSX } from "preact";
import { useLayoutEffect, useRef } from "preact/hooks";
import { controlHolder, controlText } from "../logic/permissions";
import { t } from "../texts/texts";
import { Button, usePage } from "./ui";

export function ControlBar(): JSX.Element {
  const { store: { state }, commands, authentication } = usePage();
  const { identity, control, link, token } = state;
  const holder = controlHolder(state);
  const role = identity?.role;
  const sentence = controlText(state);
  const needs_none = holder === "mine" || role === "view" || role === "propose" || control.policy === "shared";
  return (
    <div class="control" data-holder={holder} hidden={sentence === "" || !link.connected}>
      <span data-testid="control" role="status" title={sentence}>{sentence}</span>
      <Button testid="take-control" title={t("control.take.title")} hidden={needs_none} disabled={holder === "another"} press={() => void commands.trigger("/arm/take_control")}>{t("control.take")}</Button>
      {/* The server lets only administrators with a token take over. */}
      <Button testid="take-over" title={t("control.over.title")} hidden={holder !== "another" || role !== "admin" || !token.held} press={() => void commands.takeOver()}>{t("control.over")}</Button>
      <Button testid="release-control" title={t("control.release.title")} hidden={holder !== "mine"} press={() => void commands.trigger("/arm/release_control")}>{t("control.release")}</Button>
      <Button testid="enter-token" title={t("control.token.title")} hidden={role === undefined || role === "admin"} press={() => authentication.promptForToken()}>{t("control.token")}</Button>
    </div>
  );
}

/** Prompt for a token; not a modal dialog, which would block STOP. */
export function TokenForm(): JSX.Element {
  const { store: { state: { link, token } }, authentication } = usePage();
  const input = useRef<HTMLInputElement>(null);
  useLayoutEffect(() => void (token.asked && input.current?.focus()), [token.asked]);
  const enter = (event: Event): void => {
    event.preventDefault();
    const field = input.current;
    const typed = field?.value.trim() ?? "";
    if (field) field.value = "";
    if (typed === "") field?.focus();
    else authentication.authenticate(typed);
  };
  return (
    <div role="dialog" aria-label={t("token.field")} hidden={!token.asked}><form class="token" onSubmit={enter}>
      <b>{t("token.title")}</b>
      {/* Without a token so far the prompt is enough; the server's reason is shown for a wrong one. */}
      <p class="problem" data-testid="token-refused" role="alert">{token.held ? link.refused : ""}</p>
      <input ref={input} type="password" data-testid="token" aria-label={t("token.field")} autocomplete="off" spellcheck={false} maxlength={256} />
      <div class="buttons">
        <button type="submit" class="primary" data-testid="use-token">{t("token.connect")}</button>
        <Button testid="without-token" press={() => authentication.authenticate(null)}>{t("token.without")}</Button>
      </div>
    </form></div>
  );
}
