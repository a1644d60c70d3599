// The one function of Node that vite.config.ts uses.
declare module "node:fs" {
  export function readFileSync(path: URL, encoding: "utf8"): string;
}
