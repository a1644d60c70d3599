import { afterEach, describe, expect, it, test } from "vitest";
import GERMAN from "./de.json";
import ENGLISH from "./en.json";
import { chosenLanguage, t, useLanguage, type TextKey } from "./texts";

afterEach(() => useLanguage("en"));

describe("chosenLanguage", () => {
  it.each([
    ["the user's choice", "de", ["en-US"], "de"],
    ["the browser's first that there is", "", ["fr-FR", "de-AT", "en"], "de"],
    ["English without any", "", ["fr"], "en"],
    ["English for an unknown choice", "xx", [], "en"],
  ])("is %s", (_, wanted, of_browser, language) => {
    expect(chosenLanguage(wanted, of_browser)).toBe(language);
  });
});

test("a text is that of the present language", async () => {
  await useLanguage("de");
  expect(t("panel.settings")).toBe("Einstellungen");
});

test.each(Object.keys(ENGLISH) as TextKey[])("%s has the same braces in German", (key) => {
  const braces = (text: string): string[] => (text.match(/\{\w+\}/g) ?? []).sort();
  expect(braces(GERMAN[key])).toEqual(braces(ENGLISH[key]));
});
