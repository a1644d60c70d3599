import { button, el, write } from "./dom";
import type { Page } from "./page";

/** The button that stops the arm, above everything else; Esc presses it. */
export function stopButton({ store, stopping }: Page): HTMLElement {
  const press = (): void => void stopping.stop();
  const stop = button("", "stop", press, "Stop the arm (Esc)");
  stop.id = "stop";
  stop.setAttribute("aria-keyshortcuts", "Escape");
  const answer = el("span", { class: "stop-answer", role: "status" });
  stop.append(el("strong", { text: "STOP" }), answer);
  const onKey = (event: KeyboardEvent): void => {
    if (event.key === "Escape" && !event.repeat) press();
  };
  // In the capturing phase, so that nothing on the page can keep the key for itself.
  window.addEventListener("keydown", onKey, { capture: true });
  store.subscribe(
    (state) => state.stop,
    ({ phase, text }) => {
      stop.dataset["phase"] = phase;
      write(answer, text);
    },
  );
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      stop.dataset["link"] = connected ? "up" : "down";
      stop.title = connected ? "Stop the arm (Esc)" : "Not connected: the arm's power switch stops it";
    },
  );
  return stop;
}
