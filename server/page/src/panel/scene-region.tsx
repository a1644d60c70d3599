import type { JSX } from "preact";
import { MAX_PLACE_M } from "../logic/scene-objects";
import type { Region, Slice } from "../state/state";
import { t } from "../texts/texts";
import { MeasureField, Problems, Section, Select, Tick, usePage } from "./ui";

export function RegionSection(): JSX.Element {
  const { store } = usePage();
  const { region } = store.state;
  const { shown, slice, cells, total } = region;
  const change = (patch: Partial<Slice>): void => store.patch("region", { slice: { ...store.state.region.slice, ...patch } });
  return (
    <Section name="region" title={t("world.region")} open={false}>
      <Tick testid="region-shown" checked={shown} take={(on) => store.patch("region", { shown: on })} text={t("world.region.show")} />
      <Problems>
        <div class="measures">
          <Select testid="region-slice" label={t("world.region.slice")} value={slice.kind} options={[["upright", t("world.region.upright")], ["level", t("world.region.level")]]} take={(kind) => change({ kind: kind === "level" ? "level" : "upright" })} />
          {slice.kind === "level"
            ? <MeasureField key="height" testid="region-height" name={t("world.region.height")} lower={-MAX_PLACE_M} upper={MAX_PLACE_M} value={slice.height_m} take={(height_m) => change({ height_m })} />
            : <MeasureField key="angle" testid="region-angle" kind="revolute" name={t("world.region.angle")} lower={-Math.PI} upper={Math.PI} value={slice.angle_rad} take={(angle_rad) => change({ angle_rad })} />}
        </div>
      </Problems>
      <progress data-testid="region-progress" aria-label={t("world.region.progress")} max={1} hidden={!shown || total === 0 || cells.length >= total} value={total > 0 ? cells.length / total : 0} />
      <p class="hint" data-testid="region-text" role="status">{regionText(region)}</p>
      <p class="region-legend" hidden={!shown}>
        {(["free", "contact"] as const).map((reach) => <span key={reach}><span class="swatch" data-reach={reach} />{t(`world.region.${reach}`)}</span>)}
      </p>
    </Section>
  );
}

/** Return the sentence about the computation; whole tenths alone, as a screen reader reads each. */
function regionText({ shown, cells, total, problem }: Region): string {
  if (problem !== "") return problem;
  if (!shown) return t("world.region.hint");
  if (total === 0) return t("world.region.waiting");
  if (cells.length < total) return t("world.region.computing", { percent: Math.floor((10 * cells.length) / total) * 10 });
  const free = cells.filter(({ reach }) => reach === "free").length;
  return t("world.region.done", { free, total });
}
