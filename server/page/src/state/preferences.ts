/** Load a preference from the browser's storage, or its default. */
export function loadPreference(key: string, fallback: string): string {
  try {
    return localStorage.getItem(`armbridge-${key}`) ?? fallback;
  } catch {
    // A browser may refuse to store anything.
    return fallback;
  }
}

/** Store a preference in the browser; false where the browser refuses, and it lasts until the page is loaded again. */
export function storePreference(key: string, value: string): boolean {
  try {
    localStorage.setItem(`armbridge-${key}`, value);
    return true;
  } catch {
    return false;
  }
}
