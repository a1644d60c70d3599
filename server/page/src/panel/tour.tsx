import { signal } from "@preact/signals";
import type { JSX } from "preact";
import { useLayoutEffect, useRef } from "preact/hooks";
import { isOneArm } from "../logic/joints";
import { openPanel } from "../logic/layout";
import { t, type TextKey } from "../texts/texts";
import { Button, usePage } from "./ui";

const STEPS: readonly [TextKey, string][] = [
  ["tour.ball", "#view"],
  ["tour.primary", ".transport"],
  ["tour.stop", "#stop"],
  ["tour.more", "#rail"],
];

const step = signal<number | null>(null);

export function Tour(): JSX.Element {
  const { store } = usePage();
  const next = useRef<HTMLButtonElement>(null);
  const index = step.value;
  const [text, selector] = STEPS[index ?? STEPS.length] ?? [null, ""];
  useLayoutEffect(() => {
    if (selector === "") return;
    if (index === 0) next.current?.focus();
    // The view may put another canvas into the place of the first one.
    document.querySelector(selector)?.classList.add("pointed-at");
    return () => document.querySelector(selector)?.classList.remove("pointed-at");
  }, [index]);
  const goOn = (): void => {
    const following = (index ?? 0) + 1;
    step.value = following < STEPS.length ? following : null;
  };
  return (
    <aside class="first-motion" data-testid="tour" aria-label={t("tour.title")} hidden={index === null}>
      <p data-testid="tour-text" role="status">{text && t(text === "tour.ball" && !isOneArm(store.state) ? "tour.poses" : text)}</p>
      <button ref={next} type="button" class="primary" data-testid="tour-next" onClick={goOn}>{t(index === STEPS.length - 1 ? "tour.end" : "tour.next")}</button>
    </aside>
  );
}

export function TourStart(): JSX.Element {
  const { store } = usePage();
  const start = (): void => {
    step.value = 0;
    // The ball and the button belong to Move.
    store.set({ layout: openPanel(store.state.layout, "move") });
  };
  return <Button testid="tour-start" press={start}>{t("tour.title")}</Button>;
}
