import { button, el, write } from "./dom";
import { gated } from "./gate";
import type { Page } from "./page";

/** Below this share of the joints' limits a motion lasts minutes. */
const SLOWEST = 0.01;

/** How fast motions are planned, and how fast the present one goes along its path. */
export function speed(page: Page): HTMLElement {
  return el("div", { class: "rows" }, planned(page), gated(page, "drive", pace(page)), course(page));
}

function slider(testid: string, label: string, least: number): HTMLInputElement {
  const attributes = { min: String(least), max: "1", step: "0.01" };
  return el("input", { type: "range", testid, label, attributes });
}

function planned({ store }: Page): HTMLElement {
  const input = slider("speed", "speed of new motions", SLOWEST);
  const text = el("output", { testid: "speed-text" });
  input.addEventListener("input", () => store.patch("settings", { speed: Number(input.value) }));
  store.subscribe(
    (state) => state.settings.speed,
    (share) => {
      input.value = String(share);
      write(text, `${Math.round(share * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: "Speed of new motions" }), input, text);
}

function pace({ store, orders }: Page): HTMLElement {
  const input = slider("pace", "pace of the present motion", 0);
  const text = el("output", { testid: "pace-text" });
  input.addEventListener("input", () => orders.setSpeedFactor(Number(input.value)));
  store.subscribe(
    (state) => state.arm.speed_factor,
    (factor) => {
      if (!input.matches(":active")) input.value = String(factor);
      write(text, `${Math.round(factor * 100)} %`);
    },
  );
  return el("label", { class: "line" }, el("span", { text: "Pace, also while it moves" }), input, text);
}

function course(page: Page): HTMLElement {
  const { store, orders } = page;
  const order = (service: string) => (): void => void orders.order(service);
  const pause = button("Pause", "pause", order("/arm/pause"), "Come to rest on the path and wait there");
  const resume = button("Resume", "resume", order("/arm/resume"), "Go on forward");
  const back = button("Step back", "step-back", order("/arm/step_back"), "Go back along the path");
  const box = el("div", { class: "buttons" }, gated(page, "work", pause), gated(page, "drive", resume, back));
  const show = (): void => {
    const { arm, goal } = store.state;
    box.hidden = arm.mode !== "moving" && goal.state !== "executing";
    pause.disabled = arm.course === "paused";
    resume.disabled = arm.course === "forward";
  };
  store.subscribe((state) => state.arm, show);
  store.subscribe((state) => state.goal, show);
  return box;
}
