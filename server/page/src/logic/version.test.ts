import { expect, test } from "vitest";
import { versionMismatch } from "./version";

test("a server of another version is named with the page's", () => {
  expect(versionMismatch("0.2.0", "0.1.0")).toBe("The server is version 0.2.0, this page is of version 0.1.0: load the page again.");
});

test.each([
  ["the same version", "0.1.0"],
  ["a server that tells none", ""],
])("%s is no mismatch", (_, server) => {
  expect(versionMismatch(server, "0.1.0")).toBe("");
});
