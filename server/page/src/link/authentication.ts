import type { PageStore } from "../state/store";
import type { Connection } from "./connection";

/** Return the token of a page address, from `#token=` or `?token=`; null without one. */
export function tokenFromUrl(page: string): string | null {
  const url = new URL(page);
  // Browsers do not send the fragment, so a token there is in no server's log.
  return tokenFromQuery(url.hash.slice(1)) ?? tokenFromQuery(url.search.slice(1));
}

/** Return a page address without its token, which would be visible and bookmarked. */
export function urlWithoutToken(page: string): string {
  const url = new URL(page);
  if (tokenFromQuery(url.hash.slice(1)) !== null) url.hash = "";
  url.searchParams.delete("token");
  return url.href;
}

function tokenFromQuery(fields: string): string | null {
  // URLSearchParams reads a plus sign as a space; tokens have no spaces, but may have plus signs.
  return new URLSearchParams(fields.replaceAll("+", "%2B")).get("token") || null;
}

/** Key of the token in sessionStorage, which lasts until the tab is closed. */
const STORAGE_KEY = "armbridge-token";

/** Token for browsers that refuse to store anything. */
let unstored_token: string | null = null;

export function storedToken(): string | null {
  try {
    return sessionStorage.getItem(STORAGE_KEY) ?? unstored_token;
  } catch {
    return unstored_token;
  }
}

export function storeToken(token: string | null): void {
  unstored_token = token;
  try {
    if (token === null) sessionStorage.removeItem(STORAGE_KEY);
    else sessionStorage.setItem(STORAGE_KEY, token);
  } catch {
    // A browser without storage: the token lasts until the page is loaded again.
  }
}

/** Move the token from the page's address into storage; return false when there is none. */
export function takeTokenFromUrl(): boolean {
  const token = tokenFromUrl(location.href);
  if (token === null) return false;
  storeToken(token);
  history.replaceState(null, "", urlWithoutToken(location.href));
  return true;
}

/** Return the headers of a request for the robot's files: the token as in RFC 6750, section 2.1. */
export function authorizationHeaders(): Record<string, string> {
  const token = storedToken();
  return token === null ? {} : { Authorization: `Bearer ${token}` };
}

export class Authentication {
  constructor(
    private readonly connection: Connection,
    private readonly store: PageStore,
  ) {
    this.updateState();
    store.subscribe(
      (state) => state.link.refused,
      (refused) => refused && this.promptForToken(),
    );
    // Browsers do not reload a page when only the fragment of its address changes.
    window.addEventListener("hashchange", () => takeTokenFromUrl() && this.reconnect());
  }

  promptForToken(): void {
    this.store.patch("token", { asked: true });
  }

  authenticate(token: string | null): void {
    storeToken(token);
    this.reconnect();
  }

  private reconnect(): void {
    this.updateState();
    this.connection.reopen();
  }

  private updateState(): void {
    this.store.set({ token: { held: storedToken() !== null, asked: false } });
  }
}
