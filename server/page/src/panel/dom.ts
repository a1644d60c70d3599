/** What an element is made with; `data` are data- attributes, `on` its listeners. */
export interface Making {
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

/** Make an element with its children. */
export function el<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  making: Making = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  const named = { class: making.class, id: making.id, title: making.title, type: making.type, role: making.role };
  const attributes = { ...named, "aria-label": making.label, "data-testid": making.testid, ...making.attributes };
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined) element.setAttribute(name, value);
  }
  if (making.text !== undefined) element.textContent = making.text;
  for (const [event, listener] of Object.entries(making.on ?? {})) element.addEventListener(event, listener);
  element.append(...children);
  return element;
}

/** A button that does something. */
export function button(text: string, testid: string, press: () => void, title = ""): HTMLButtonElement {
  const making: Making = { type: "button", testid, text, on: { click: press } };
  return el("button", title ? { ...making, title } : making);
}

/** Write a text, and touch the page only when it is another. */
export function write(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** A part of the panel that can be folded; whether it is open is kept by the browser. */
export function section(name: string, title: string, open: boolean, ...children: (Node | string)[]): HTMLDetailsElement {
  const details = el("details", { class: "section", id: `section-${name}`, testid: `section-${name}` });
  details.append(el("summary", { text: title }), ...children);
  details.open = remembered(`open-${name}`, String(open)) === "true";
  details.addEventListener("toggle", () => remember(`open-${name}`, String(details.open)));
  return details;
}

/** What the browser keeps of an earlier visit, or a default. */
export function remembered(key: string, otherwise: string): string {
  try {
    return localStorage.getItem(`armbridge-${key}`) ?? otherwise;
  } catch {
    // A browser may refuse to keep anything.
    return otherwise;
  }
}

/** Let the browser keep something for the next visit. */
export function remember(key: string, value: string): void {
  try {
    localStorage.setItem(`armbridge-${key}`, value);
  } catch {
    // As above: then it is forgotten.
  }
}
