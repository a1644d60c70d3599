import { PAGE_VERSION } from "../logic/version";
import { LANGUAGES, t } from "../texts/texts";
import type { PanelContext } from "./context";
import { el, loadPreference, option, storePreference } from "./dom";

/** Create the settings of this page in this browser: units, language and colours. */
export function settingsSection(context: PanelContext): HTMLElement {
  const version = el("p", { class: "hint", text: t("settings.version", { version: PAGE_VERSION }) });
  return el("div", { class: "rows settings" }, unitChoice(context), languageChoice(), themeChoice(), version);
}

/** Create the choice of units: degrees and millimetres, or radians and metres. */
function unitChoice({ store }: PanelContext): HTMLElement {
  const choice = el("select", { testid: "units", id: "units" });
  for (const value of ["deg", "rad"] as const) {
    choice.append(option(value, t(`settings.units.${value}`)));
  }
  const apply = (): void => store.patch("settings", { units: choice.value === "rad" ? "rad" : "deg" });
  choice.value = loadPreference("units", "deg") === "rad" ? "rad" : "deg";
  apply();
  choice.addEventListener("change", () => {
    storePreference("units", choice.value);
    apply();
  });
  return el("label", { class: "line" }, `${t("settings.units")} `, choice);
}

function languageChoice(): HTMLElement {
  const choice = el("select", { testid: "language" });
  for (const [tag, { name }] of Object.entries(LANGUAGES)) {
    choice.append(option(tag, name, { lang: tag }));
  }
  choice.value = document.documentElement.lang;
  choice.addEventListener("change", () => {
    storePreference("language", choice.value);
    location.reload();
  });
  return el("label", { class: "line" }, `${t("settings.language")} `, choice);
}

/** Create the choice of colours: light, dark, or the system's; the view reads the same attribute. */
function themeChoice(): HTMLElement {
  const choice = el("select", { testid: "theme" });
  for (const value of ["system", "light", "dark"] as const) {
    choice.append(option(value, t(`settings.colours.${value}`)));
  }
  const apply = (theme: string): void => {
    if (theme === "system") delete document.documentElement.dataset["theme"];
    else document.documentElement.dataset["theme"] = theme;
  };
  choice.value = loadPreference("theme", "system");
  apply(choice.value);
  choice.addEventListener("change", () => {
    storePreference("theme", choice.value);
    apply(choice.value);
  });
  return el("label", { class: "line" }, `${t("settings.colours")} `, choice);
}
