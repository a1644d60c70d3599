import { MAX_PLACE_M } from "../logic/scene-objects";
import type { Region, Slice } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { el, option, section, setText } from "./dom";
import { measureField } from "./scene-fields";

/** Create the section of the reachable region: the switch, its slice, and the progress of its computation. */
export function regionSection({ store }: PanelContext): HTMLElement {
  const shown = el("input", { type: "checkbox", testid: "region-shown" });
  shown.addEventListener("change", () => store.patch("region", { shown: shown.checked }));
  const change = (patch: Partial<Slice>): void => store.patch("region", { slice: { ...store.state.region.slice, ...patch } });
  const kind = el("select", { testid: "region-slice", label: t("world.region.slice") });
  kind.append(...(["upright", "level"] as const).map((value) => option(value, t(`world.region.${value}`))));
  kind.addEventListener("change", () => change({ kind: kind.value === "level" ? "level" : "upright" }));
  const height_label = t("world.region.height");
  const height = measureField(
    store,
    { testid: "region-height", kind: "prismatic", name: height_label, label: height_label, lower: -MAX_PLACE_M, upper: MAX_PLACE_M },
    (height_m) => change({ height_m }),
  );
  const angle_label = t("world.region.angle");
  const angle = measureField(
    store,
    { testid: "region-angle", kind: "revolute", name: angle_label, label: angle_label, lower: -Math.PI, upper: Math.PI },
    (angle_rad) => change({ angle_rad }),
  );
  const progress = el("progress", { testid: "region-progress", label: t("world.region.progress"), attributes: { max: "1" } });
  const text = el("p", { class: "hint", testid: "region-text", role: "status" });
  const legend = el("p", { class: "region-legend" });
  for (const reach of ["free", "contact"] as const) {
    const swatch = el("span", { class: "swatch", attributes: { "data-reach": reach } });
    legend.append(el("span", {}, swatch, t(`world.region.${reach}`)));
  }
  store.subscribe(
    (state) => state.region,
    (region) => {
      const { slice, cells, total } = region;
      height.element.hidden = slice.kind !== "level";
      angle.element.hidden = slice.kind !== "upright";
      height.show(slice.height_m);
      angle.show(slice.angle_rad);
      progress.hidden = !region.shown || total === 0 || cells.length >= total;
      progress.value = total > 0 ? cells.length / total : 0;
      legend.hidden = !region.shown;
      setText(text, regionText(region));
    },
  );
  store.subscribe(({ settings }) => settings.units, () => [height, angle].forEach((field) => field.refresh()));
  const settings = el("div", { class: "measures" }, kind, height.element, angle.element);
  const problems = el("div", {}, height.problem, angle.problem);
  return section("region", t("world.region"), false, el("label", { class: "line" }, shown, t("world.region.show")), settings, problems, progress, text, legend);
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
