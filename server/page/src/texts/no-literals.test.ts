import { describe, expect, it, test } from "vitest";

const SOURCES = import.meta.glob<string>(
  ["../{link,logic,panel,state,view}/*.{ts,tsx}", "../main.ts", "!../*/*.test.ts"],
  { query: "?raw", import: "default", eager: true },
);

/** Places of a text that a person sees or hears: children and attributes of elements, options of `el`, arguments of helpers. */
const SHOWN = [
  /(>)([^<>{}()=;]*\p{L}{2}[^<>{}()=;]*)<\//gu,
  /\b(?:text|title|label|name|placeholder|aria-(?:label|valuetext|description))=(")(?=\p{Lu}|[^"\n]* )(.*?)"/gu,
  /\b(?:text|title|label|placeholder)"?: (["'`])(.*?)\1/g,
  /\.(?:title|textContent|placeholder|ariaLabel) = (["'`])(.*?)\1/g,
  /\bsetAttribute\("(?:title|placeholder|aria-(?:label|valuetext|description))", (["'`])(.*?)\1/g,
  /\bsetText\(\w+, (["'`])(.*?)\1/g,
  /\bbutton\((["'`])(.*?)\1/g,
  /\bbutton\([^\n]*, (["'`])([^"'`]*?)\1\)[;,]?$/gm,
  /\bsection\("[\w-]+", (["'`])(.*?)\1/g,
  /\bnumberField\([^,\n]+, (["'`])(.*?)\1/g,
  /\bel\("\w+", \{[^}\n]*\}, (["'`])(.*?)\1/g,
];

/** Comments, classes of elements, queries of CSS, and what is compared with: their words are not shown. */
const NOT_SHOWN = [
  /\/\*[\s\S]*?\*\//g,
  /(?<=^|\s)\/\/[^\n]*/g,
  /\bclass(?:Name = |: |=)(["'`])[^\n]*?\1/g,
  /\b(?:matchMedia|matches|includes|font =) ?\(?(["'`])[^\n]*?\1/g,
];

/** Every literal of one line. */
const LITERAL = /(["'`])((?:\\.|(?!\1)[^\\\n])*)\1/g;

/** Words in a row, or a value and a word: sentences of returned values, errors and notices, wherever they stand. */
const SENTENCE = /\p{L}{2}[,:;]? (?:\p{L}|…)\p{L}*[ .,:;]|\p{L}{2}[,:;]? \p{L}{2}|… \p{L}{2}|^\p{Lu}\p{L}+: …/u;

/** Return the words that a module shows without taking them from the table; signs, values and units are none. */
function literals(source: string): string[] {
  const code = NOT_SHOWN.reduce((rest, part) => rest.replace(part, ""), source);
  const placed = SHOWN.flatMap((place) => [...code.matchAll(place)].map(([, , text = ""]) => text));
  const shown = placed.filter((text) => /\p{L}{2}/u.test(withoutValues(text)));
  const sentences = [...code.matchAll(LITERAL)].map(([, , text = ""]) => text).filter((text) => SENTENCE.test(withoutValues(text)));
  return [...new Set([...shown, ...sentences])];
}

/** Return a template text with a sign in place of what is filled in, and without units. */
function withoutValues(text: string): string {
  return text.replace(/\$\{[^}]*\}/g, "…").replace(/\b(?:mm|ms|min|rad|kB|MB)\b/g, "");
}

describe("literals", () => {
  it.each([
    ["a child of JSX", "<b>Joints</b>", ["Joints"]],
    ["a label of JSX", '<input aria-label="Name" />', ["Name"]],
    ["a text option", 'el("b", { text: "Joints" })', ["Joints"]],
    ["a label", 'el("input", { testid: "x", label: "name of the pose" })', ["name of the pose"]],
    ["a button", 'button("Plan", "plan", press)', ["Plan"]],
    ["a tooltip", 'const plan = button(t("a"), "plan", press, "Nothing moves");', ["Nothing moves"]],
    ["a section", 'section("log", "Log", true)', ["Log"]],
    ["a child", 'el("label", { class: "line" }, "Speed ", slider)', ["Speed "]],
    ["words about values", "setText(text, `${a} of ${b} s`)", ["${a} of ${b} s"]],
    ["a notice", 'setNotice(store, "save", done ? "" : `“${name}” could not be saved`);', ["“${name}” could not be saved"]],
    ["a result", 'this.report(null, "Press Plan first.");', ["Press Plan first."]],
    ["an error", 'throw new Error("nothing in it");', ["nothing in it"]],
    ["a returned sentence", "return `link ${name} has no shape`;", ["link ${name} has no shape"]],
    ["a word after a value", "show(`${distance} off`, at);", ["${distance} off"]],
    ["a word before a value", "const text = `Gripper: ${reason}`;", ["Gripper: ${reason}"]],
    ["an answer of a table", '404: "the server does not have it",', ["the server does not have it"]],
  ])("finds %s", (_, source, found) => expect(literals(source)).toEqual(found));

  it.each([
    ["a text of the table in JSX", '<b title={t("a")}>{t("move.plan")}</b>'],
    ["a text of the table", 'button(t("move.plan"), "plan", press, t("move.plan.hint"))'],
    ["a sign", 'button("×", "close", press)'],
    ["a value with its unit", "setText(text, `${value} mm`)"],
    ["an id", 'el("b", { testid: "joints", text: name })'],
    ["a comment", "// The arm stands.\n/** Return a `long text` of it. */"],
    ["classes", 'el("div", { class: "line wide" })'],
    ["a query of CSS", 'matchMedia("(prefers-color-scheme: dark)").matches'],
    ["a service with its answer", "setNotice(store, key, `${service}: ${message}`)"],
  ])("passes %s", (_, source) => expect(literals(source)).toEqual([]));
});

test.each(Object.entries(SOURCES))("%s takes its texts from the table", (_, source) => {
  expect(literals(source)).toEqual([]);
});
