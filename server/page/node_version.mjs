// Ends with one line on stderr and code 1 where this Node.js is none that package.json's engines allow.
import { readFileSync } from "node:fs";

const wanted = JSON.parse(readFileSync(new URL("package.json", import.meta.url), "utf8")).engines.node;
const [major, minor] = process.versions.node.split(".").map(Number);
const allowed = wanted.split("||").some((range) => {
  const [, sign, least, leastMinor] = /^\s*(\^|>=)(\d+)\.(\d+)/.exec(range);
  return (major === Number(least) && minor >= Number(leastMinor)) || (sign === ">=" && major > Number(least));
});
if (!allowed) {
  console.error(`Node.js ${process.versions.node} cannot build the page, which needs Node.js ${wanted}`);
  process.exitCode = 1;
}
