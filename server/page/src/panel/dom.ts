import { parseNumber, type NumberRange } from "../logic/numbers";
import { throttle } from "../logic/throttle";
import { loadPreference, storePreference } from "../state/preferences";
import { t } from "../texts/texts";

/** Attributes, text and event listeners (`on`) of a new element. */
export interface ElementOptions {
  class?: string;
  id?: string;
  testid?: string;
  text?: string;
  title?: string;
  type?: string;
  label?: string;
  role?: string;
  on?: Record<string, (event: Event) => void>;
  attributes?: Record<string, string>;
}

/** Create an element with its children. */
export function el<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  options: ElementOptions = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  const named = { class: options.class, id: options.id, title: options.title, type: options.type, role: options.role };
  const attributes = { ...named, "aria-label": options.label, "data-testid": options.testid, ...options.attributes };
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined) element.setAttribute(name, value);
  }
  if (options.text !== undefined) element.textContent = options.text;
  for (const [event, listener] of Object.entries(options.on ?? {})) element.addEventListener(event, listener);
  element.append(...children);
  return element;
}

/** Create a button. */
export function button(text: string, testid: string, press: () => void, title = ""): HTMLButtonElement {
  const options: ElementOptions = { type: "button", testid, text, on: { click: press } };
  return el("button", title ? { ...options, title } : options);
}

/** Create a button that deletes something at its second press: the first one asks, until the button loses the focus. */
export function deleteButton(text: string, testid: string, name: string, remove: () => void): HTMLButtonElement {
  let asking = false;
  const ask = (now: boolean): void => {
    asking = now;
    setText(press, asking ? t("ask.delete") : text);
    press.classList.toggle("asking", asking);
  };
  const press = el("button", { type: "button", testid, text, label: `${t("ask.label")}: ${name}` });
  press.addEventListener("click", ({ detail }) => {
    // The second click of a double click is no answer.
    if (detail > 1) return;
    if (asking) remove();
    ask(!asking);
  });
  press.addEventListener("blur", () => ask(false));
  return press;
}

/** Texts and test ids of a form for a name. */
export interface NameFormOptions {
  testid: string;
  label: string;
  /** Button that submits. */
  button: string;
  button_testid: string;
  title?: string;
}

/** Create a form for a name; a name that `submit` returns true for is cleared. */
export function nameForm({ testid, label, button: text, button_testid, title = "" }: NameFormOptions, submit: (name: string) => boolean | Promise<boolean>): HTMLElement {
  const name = el("input", { type: "text", testid, attributes: { autocomplete: "off", maxlength: "50" } });
  const send = async (): Promise<void> => {
    const typed = name.value.trim();
    if (typed === "") name.focus();
    if (await submit(typed)) name.value = "";
  };
  name.addEventListener("keydown", (event) => event.key === "Enter" && void send());
  return el("div", { class: "save-scene" }, el("label", {}, label, name), button(text, button_testid, () => void send(), title));
}

const SVG = "http://www.w3.org/2000/svg";

/** Create an element of a drawing. */
export function svg(tag: string, attributes: Record<string, string | number>, ...children: (Node | string)[]): SVGElement {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/** Create an icon from a path in a square of 24. */
export function icon(path: string): SVGElement {
  return svg("svg", { viewBox: "0 0 24 24", class: "icon", "aria-hidden": "true" }, svg("path", { d: path }));
}

/** Create an option of a choice. */
export function option(value: string, text: string, attributes: Record<string, string> = {}): HTMLOptionElement {
  return el("option", { text, attributes: { value, ...attributes } });
}

/** Create a line with a text before its control. */
export function labelled(text: string, control: HTMLElement): HTMLElement {
  return el("label", { class: "line" }, `${text} `, control);
}

/** Return a text with a capital first letter. */
export function capitalized(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Set a text; an unchanged one is left alone, which spares the browser a layout. */
export function setText(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Show texts as the items of a list, which is hidden without any; unchanged ones are left alone. */
export function showList(list: HTMLElement, texts: readonly string[]): void {
  list.hidden = texts.length === 0;
  if (texts.join("\n") === [...list.children].map(({ textContent }) => textContent).join("\n")) return;
  list.replaceChildren(...texts.map((text) => el("li", { text })));
}

/** Item of a keyed list: its element, and the update of what it shows. */
export interface ListItem<Value> {
  element: HTMLElement;
  show: (value: Value, index: number) => void;
}

/**
 * Return a function that shows values as the children of a list; a value keeps its element as long as there is its key.
 *
 * So a press that lasts, the focus and a text that is being typed outlive an update.
 */
export function keyedList<Value>(
  list: HTMLElement,
  keyOf: (value: Value) => string,
  create: (value: Value) => ListItem<Value>,
): (values: readonly Value[]) => void {
  const items = new Map<string, ListItem<Value>>();
  return (values) => {
    const keys = values.map(keyOf);
    const focused = document.activeElement;
    for (const [key, { element }] of items) {
      if (keys.includes(key)) continue;
      element.remove();
      items.delete(key);
    }
    for (const [index, value] of values.entries()) {
      const key = keys[index] ?? "";
      const item = items.get(key) ?? create(value);
      items.set(key, item);
      if (list.children[index] !== item.element) list.insertBefore(item.element, list.children[index] ?? null);
      item.show(value, index);
    }
    // An element that is moved loses it.
    if (focused instanceof HTMLElement && focused !== document.activeElement && list.contains(focused)) focused.focus();
  };
}

/** Create a collapsible section of the panel; the browser stores its open state. */
export function section(name: string, title: string, open: boolean, ...children: (Node | string)[]): HTMLDetailsElement {
  const details = el("details", { class: "section", id: `section-${name}`, testid: `section-${name}` });
  details.append(el("summary", { text: title }), ...children);
  details.open = loadPreference(`open-${name}`, String(open)) === "true";
  details.addEventListener("toggle", () => storePreference(`open-${name}`, String(details.open)));
  return details;
}

/** Input for a number, with a place for its problem. */
export interface NumberField {
  input: HTMLInputElement;
  problem: HTMLElement;
  /** Show a value; while the field has the focus it keeps its text, and shows the newest value when it is left. */
  show: (text: string) => void;
}

/**
 * Create an input for a number: clamped to its limits, reverted when it is invalid, with a message for either.
 *
 * @param testid - test id of the input; that of its message is `<testid>-problem`.
 * @param range - returns the present limits.
 * @param take - called with each typed number.
 */
export function numberField(
  testid: string,
  label: string,
  range: () => NumberRange,
  take: (value: number) => void,
): NumberField {
  const problem = el("small", { class: "problem", testid: `${testid}-problem`, role: "alert" });
  const attributes = { inputmode: "decimal", autocomplete: "off", spellcheck: "false" };
  const input = el("input", { type: "text", class: "number", testid, label, attributes });
  let newest = "";
  // Enter and, after it, the browser's change come for one text.
  let edited = false;
  const write = (text: string): void => {
    if (input.value !== text) input.value = text;
  };
  const commit = (): void => {
    if (!edited) return;
    edited = false;
    const { value, message } = parseNumber(input.value, range());
    setText(problem, message);
    if (value !== null) newest = String(Number(value.toFixed(range().digits)));
    write(newest);
    if (value !== null) take(value);
  };
  input.addEventListener("input", () => {
    edited = true;
    setText(problem, "");
  });
  input.addEventListener("change", commit);
  input.addEventListener("blur", () => write(newest));
  input.addEventListener("keydown", (event) => event.key === "Enter" && commit());
  const show = (text: string): void => {
    newest = text;
    // A new text would end the user's selection, and what is typed next would be added to it.
    if (document.activeElement !== input) write(text);
  };
  return { input, problem, show };
}

export { loadPreference, storePreference, throttle };
