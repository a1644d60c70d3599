import type { JSX } from "preact";
import { healthRows } from "../logic/arm-health";
import { t } from "../texts/texts";
import { Section, useSlowState } from "./ui";

export function Health(): JSX.Element {
  const { arm_health, link } = useSlowState();
  const rows = arm_health === null ? [] : healthRows(arm_health, link.latency_ms);
  return (
    <Section name="health" title={t("health.title")}>
      <p class="hint" data-testid="health-empty" hidden={arm_health !== null}>{t("health.empty")}</p>
      <p data-testid="health-arm" hidden={arm_health === null}>{`${t("health.arm")}: ${arm_health?.message}`}</p>
      <dl class="facts" data-testid="health" hidden={arm_health === null}>
        {rows.flatMap(({ id, texts, warn }) => [
          <dt key={`${id}:`}>{t(`health.${id}`)}</dt>,
          <dd key={id} data-testid={`health-${id}`} data-warn={String(warn)}>{texts.map(([key, values]) => t(key, values)).join("; ")}</dd>,
        ])}
      </dl>
    </Section>
  );
}
