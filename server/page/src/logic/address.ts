/** The token that an address of the page has, behind `#token=` or `?token=`; null without one. */
export function tokenOf(page: string): string | null {
  const url = new URL(page);
  // What stands behind # is sent to nobody, and in nobody's log.
  return tokenIn(url.hash.slice(1)) ?? tokenIn(url.search.slice(1));
}

/** An address of the page without its token, which would be seen and bookmarked. */
export function withoutToken(page: string): string {
  const url = new URL(page);
  if (tokenIn(url.hash.slice(1)) !== null) url.hash = "";
  url.searchParams.delete("token");
  return url.href;
}

/** Where the server listens: where the page came from. */
export function serverUrl(page: string): string {
  const url = new URL("./", page);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
}

/** What shows a token when a file is fetched. */
export function authorization(token: string | null): Record<string, string> {
  return token === null ? {} : { Authorization: `Bearer ${token}` };
}

function tokenIn(fields: string): string | null {
  // A plus sign is one: tokens have no spaces.
  return new URLSearchParams(fields.replaceAll("+", "%2B")).get("token") || null;
}
