import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { t } from "../texts/texts";
import { Button, Gate, Section, usePage } from "./ui";

/** Files of the scenarios, which are scenes as World downloads them; each is loaded when it is chosen. */
const FILES = import.meta.glob<string>("../scenarios/*.json", { query: "?raw", import: "default" });

const SCENARIOS = ["table", "cubes", "shelf", "empty"] as const;
type Scenario = (typeof SCENARIOS)[number];

export function Scenarios(): JSX.Element {
  const { sceneEditor } = usePage();
  const [chosen, choose] = useState<Scenario | null>(null);
  const load = async (name: Scenario): Promise<void> => {
    try {
      await sceneEditor.loadFile((await FILES[`../scenarios/${name}.json`]?.()) ?? "", name);
      choose(name);
    } catch (error) {
      sceneEditor.edit({ result: (error as Error).message });
    }
  };
  return (
    <Section name="scenarios" title={t("world.scenarios")}>
      <p class="hint">{t("world.scenarios.hint")}</p>
      <Gate to="work">
        <div class="buttons">
          {SCENARIOS.map((name) => <Button key={name} testid={`scenario-${name}`} aria-pressed={name === chosen} press={() => void load(name)}>{t(`world.scenario.${name}`)}</Button>)}
          <Button testid="scenario-reset" disabled={chosen === null} press={() => chosen && void load(chosen)}>{t("world.scenarios.reset")}</Button>
        </div>
      </Gate>
    </Section>
  );
}
