/** Return the address that a phone is to open: the server's own for other devices, with a token that the browser keeps to itself. */
export function phoneAddress(url: string, token: string): string {
  // Browsers do not send the fragment, so the token is in no log on the way.
  return token === "" ? url : `${url}#token=${encodeURIComponent(token)}`;
}

/** Return true for a host that is this very machine, which a phone cannot open. */
export function isLoopback(host: string): boolean {
  return host === "localhost" || host === "[::1]" || host.startsWith("127.");
}

/** Return the addresses that a phone can open, the best first: the server's own ones, and the page's where it is another device's. */
export function phoneUrls(page: string, urls: readonly string[]): string[] {
  const { origin, hostname, pathname } = new URL(page);
  const own = isLoopback(hostname) ? [] : [`${origin}${pathname}`];
  return [...new Set([...own, ...urls])];
}

/** Return the dark modules of a code as one path of an SVG, whose unit is a module. */
export function modulePath(count: number, isDark: (row: number, column: number) => boolean): string {
  const parts: string[] = [];
  for (let row = 0; row < count; row += 1) {
    for (let column = 0; column < count; column += 1) {
      if (isDark(row, column)) parts.push(`M${column} ${row}h1v1h-1z`);
    }
  }
  return parts.join("");
}
