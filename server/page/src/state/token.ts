import { authorization, tokenOf, withoutToken } from "../logic/address";

/** Under which the browser keeps the token, for this tab and until it is closed. */
const KEY = "armbridge-token";

/** The token while the browser refuses to keep anything. */
let unkept: string | null = null;

/** The token of this page; null without one. */
export function heldToken(): string | null {
  try {
    return sessionStorage.getItem(KEY) ?? unkept;
  } catch {
    return unkept;
  }
}

/** Keep a token for this tab; null forgets it. */
export function keepToken(token: string | null): void {
  unkept = token;
  try {
    if (token === null) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, token);
  } catch {
    // As above: then it lasts until the page is loaded again.
  }
}

/** Take the token out of the page's address; false when there is none. */
export function takeTokenOfAddress(): boolean {
  const token = tokenOf(location.href);
  if (token === null) return false;
  keepToken(token);
  history.replaceState(null, "", withoutToken(location.href));
  return true;
}

/** The headers of a request for the robot's files. */
export function bearer(): Record<string, string> {
  return authorization(heldToken());
}
