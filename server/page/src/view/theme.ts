/** The colours of the view, for light and for dark. */
export interface Theme {
  background: number;
  grid: number;
  grid_axis: number;
  arm: number;
  arm_dark: number;
  ghost: number;
  ghost_off: number;
  path: number;
  object: number;
  collision: number;
  missing: number;
}

const LIGHT: Theme = {
  background: 0xeef1f4,
  grid: 0xc9d0d7,
  grid_axis: 0x94a0ac,
  arm: 0xf0b323,
  arm_dark: 0x3a434d,
  ghost: 0x2f7fe0,
  ghost_off: 0xd92c2c,
  path: 0x1f5fb0,
  object: 0x6f9a5c,
  collision: 0xb03fc0,
  missing: 0xd96a2c,
};

const DARK: Theme = {
  ...LIGHT,
  background: 0x161b21,
  grid: 0x2b333c,
  grid_axis: 0x4c5864,
  arm_dark: 0x59646f,
  ghost: 0x56a0ff,
  ghost_off: 0xff5a52,
  path: 0x7db7ff,
  collision: 0xe07cf0,
};

/** The theme that holds now: the page's own choice, else that of the system. */
export function currentTheme(): Theme {
  const chosen = document.documentElement.dataset["theme"];
  if (chosen === "light") return LIGHT;
  if (chosen === "dark") return DARK;
  return matchMedia("(prefers-color-scheme: dark)").matches ? DARK : LIGHT;
}

/** Calls back whenever the theme may have changed; the answer ends it. */
export function watchTheme(changed: () => void): () => void {
  const system = matchMedia("(prefers-color-scheme: dark)");
  const page = new MutationObserver(changed);
  system.addEventListener("change", changed);
  page.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
  return () => {
    system.removeEventListener("change", changed);
    page.disconnect();
  };
}
