// The one function of Node that vite.config.ts uses.
declare module "node:fs" {
  /** Read a whole text file. */
  export function readFileSync(path: URL, encoding: "utf8"): string;
}
