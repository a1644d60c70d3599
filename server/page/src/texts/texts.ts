import ENGLISH from "./en.json";

export type TextKey = keyof typeof ENGLISH;

/** Every text of the page in one language; words in braces are filled in. */
export type Texts = Record<TextKey, string>;

/** Languages of the page by their tag, each with its name in itself; another one is a file beside en.json and a line here. */
export const LANGUAGES: Record<string, { name: string; load: () => Promise<Texts> }> = {
  en: { name: "English", load: async () => ENGLISH },
  de: { name: "Deutsch", load: async () => (await import("./de.json")).default },
};

let present: Texts = ENGLISH;

/** Return the language of the page: the wanted one, else the first of the browser's that the page has, else English. */
export function chosenLanguage(wanted: string, of_browser: readonly string[]): string {
  const tags = [wanted, ...of_browser].map((tag) => tag.split("-")[0] ?? "");
  return tags.find((tag) => tag in LANGUAGES) ?? "en";
}

/** Use a language from now on; texts that are shown already stay as they are. */
export async function useLanguage(tag: string): Promise<void> {
  present = (await LANGUAGES[tag]?.load()) ?? ENGLISH;
}

/** Return a text of the present language, with the values in place of its braces. */
export function t(key: TextKey, values: Record<string, string | number> = {}): string {
  return present[key].replace(/\{(\w+)\}/g, (braces, name: string) => String(values[name] ?? braces));
}

export function capitalized(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}
