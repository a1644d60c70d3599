import type { JSX } from "preact";
import { PAGE_VERSION } from "../logic/version";
import { loadPreference, storePreference } from "../state/preferences";
import type { PageStore } from "../state/store";
import { LANGUAGES, t } from "../texts/texts";
import { Line, Select, usePage } from "./ui";

export function Settings(): JSX.Element {
  const { store } = usePage();
  const choose = (key: "units" | "theme", chosen: string): void => {
    storePreference(key, chosen);
    loadSettings(store);
  };
  const chooseLanguage = (language: string): void => {
    storePreference("language", language);
    location.reload();
  };
  return (
    <div class="rows settings">
      <Line text={t("settings.units")}>
        <Select testid="units" value={store.state.settings.units} options={(["deg", "rad"] as const).map((value) => [value, t(`settings.units.${value}`)])} take={(units) => choose("units", units)} />
      </Line>
      <Line text={t("settings.language")}>
        <select data-testid="language" onChange={({ currentTarget }) => chooseLanguage(currentTarget.value)} value={document.documentElement.lang}>
          {Object.entries(LANGUAGES).map(([tag, { name }]) => <option key={tag} value={tag} lang={tag}>{name}</option>)}
        </select>
      </Line>
      <Line text={t("settings.colours")}>
        <Select testid="theme" value={loadPreference("theme", "system")} options={(["system", "light", "dark"] as const).map((value) => [value, t(`settings.colours.${value}`)])} take={(theme) => choose("theme", theme)} />
      </Line>
      <p class="hint">{t("settings.version", { version: PAGE_VERSION })}</p>
    </div>
  );
}

/** Apply the stored units and colours; the view reads the same attribute. */
export function loadSettings(store: PageStore): void {
  store.patch("settings", { units: loadPreference("units", "deg") === "rad" ? "rad" : "deg" });
  const theme = loadPreference("theme", "system");
  if (theme === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
}
