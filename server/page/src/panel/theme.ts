import { el, remember, remembered } from "./dom";

/** Light, dark, or as the system has it; the view looks at the same attribute. */
export function themeSwitch(): HTMLElement {
  const options = ["system", "light", "dark"].map((value) => el("option", { text: value, attributes: { value } }));
  const choice = el("select", { testid: "theme", label: "colours" }, ...options);
  const apply = (theme: string): void => {
    if (theme === "system") delete document.documentElement.dataset["theme"];
    else document.documentElement.dataset["theme"] = theme;
  };
  choice.value = remembered("theme", "system");
  apply(choice.value);
  choice.addEventListener("change", () => {
    remember("theme", choice.value);
    apply(choice.value);
  });
  return el("label", { class: "line" }, "Colours ", choice);
}
