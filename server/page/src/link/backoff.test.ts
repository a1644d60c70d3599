import { expect, test } from "vitest";
import { backoff_s } from "./backoff";

test("waits twice as long after each failure, and 2 s at most", () => {
  expect([1, 2, 3, 4, 5, 50].map(backoff_s)).toEqual([0.25, 0.5, 1, 2, 2, 2]);
});
