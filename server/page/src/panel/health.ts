import { healthRows } from "../logic/arm-health";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { isShown, whenShown } from "./shown";
import { el, section, setText, throttle } from "./dom";

/** Time between two updates [ms]; diagnostics come once a second. */
const UPDATE_PERIOD_MS = 500;

/** Create the section that says how well bus, control loop and network keep time. */
export function healthSection({ store }: PanelContext): HTMLElement {
  const message = el("p", { testid: "health-arm" });
  const rows = el("dl", { class: "facts", testid: "health" });
  const empty = el("p", { class: "hint", testid: "health-empty", text: t("health.empty") });
  const box = section("health", t("health.title"), true, empty, message, rows);
  const show = throttle<State>(UPDATE_PERIOD_MS, ({ arm_health, link }) => {
    // Not its rows: those are hidden until the first report, which may come after the panel was opened.
    if (!isShown(box)) return;
    empty.hidden = arm_health !== null;
    message.hidden = rows.hidden = arm_health === null;
    if (arm_health === null) return;
    setText(message, `${t("health.arm")}: ${arm_health.message}`);
    const items = healthRows(arm_health, link.latency_ms).flatMap(({ id, texts, warn }) => {
      const text = texts.map(([key, values]) => t(key, values)).join("; ");
      return [el("dt", { text: t(`health.${id}`) }), el("dd", { text, testid: `health-${id}`, attributes: { "data-warn": String(warn) } })];
    });
    rows.replaceChildren(...items);
  });
  store.watch(["arm_health", "link"], show);
  whenShown(box, () => show(store.state));
  return box;
}
