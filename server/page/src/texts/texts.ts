import { GERMAN } from "./de";
import { ENGLISH } from "./en";

/** Key of a text. */
export type TextKey = keyof typeof ENGLISH;

/** Every text of the page in one language. */
export type Texts = Record<TextKey, string>;

/** Languages of the page by their tag, each with its name in itself; another one is a file beside en.ts and a line here. */
export const LANGUAGES: Record<string, { name: string; texts: Texts }> = {
  en: { name: "English", texts: ENGLISH },
  de: { name: "Deutsch", texts: GERMAN },
};

let present: Texts = ENGLISH;

/** Return the language of the page: the wanted one, else the first of the browser's that the page has, else English. */
export function chosenLanguage(wanted: string, of_browser: readonly string[]): string {
  const tags = [wanted, ...of_browser].map((tag) => tag.split("-")[0] ?? "");
  return tags.find((tag) => tag in LANGUAGES) ?? "en";
}

/** Use a language from now on; texts that are shown already stay as they are. */
export function useLanguage(tag: string): void {
  present = LANGUAGES[tag]?.texts ?? ENGLISH;
}

/** Return a text of the present language, with what stands in its braces. */
export function t(key: TextKey, values: Record<string, string | number> = {}): string {
  return present[key].replace(/\{(\w+)\}/g, (braces, name: string) => String(values[name] ?? braces));
}
