import { el } from "./dom";

/** Time until the text of a saved file is let go of [ms]: browsers read it after the click. */
const RELEASE_AFTER_MS = 10_000;

/** Offer a text to the user as a file. */
export function saveFile(name: string, type: string, text: string): void {
  saveBlob(name, new Blob([text], { type: `${type};charset=utf-8` }));
}

/** Offer bytes to the user as a file. */
export function saveBlob(name: string, blob: Blob): void {
  const url = URL.createObjectURL(blob);
  el("a", { attributes: { href: url, download: name } }).click();
  setTimeout(() => URL.revokeObjectURL(url), RELEASE_AFTER_MS);
}

/** Create an input for a JSON file of the user; `take` is called with each file that is chosen. */
export function fileInput(testid: string, label: string, take: (file: File) => Promise<void>): HTMLLabelElement {
  const input = el("input", { type: "file", testid, attributes: { accept: ".json,application/json" } });
  input.addEventListener("change", () => {
    const file = input.files?.[0];
    // The same file can be chosen again.
    if (file) void take(file).finally(() => (input.value = ""));
  });
  return el("label", { class: "scene-upload" }, label, input);
}

/** Copy a text; return false where the browser does not let the page. */
export async function copyText(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return copySelection(text);
  }
}

/** Copy by a selection: pages without HTTPS have no clipboard of their own. */
function copySelection(text: string): boolean {
  const area = document.body.appendChild(el("textarea", { attributes: { readonly: "" } }));
  area.value = text;
  area.select();
  const copied = document.execCommand("copy");
  area.remove();
  return copied;
}
