/** Time until the text of a saved file is let go of [ms]: browsers read it after the click. */
const RELEASE_AFTER_MS = 10_000;

export function saveFile(name: string, type: string, text: string): void {
  saveBlob(name, new Blob([text], { type: `${type};charset=utf-8` }));
}

export function saveBlob(name: string, blob: Blob): void {
  const url = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), RELEASE_AFTER_MS);
}

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
  const area = document.body.appendChild(document.createElement("textarea"));
  area.readOnly = true;
  area.value = text;
  area.select();
  const copied = document.execCommand("copy");
  area.remove();
  return copied;
}
