import { expect, test, vi } from "vitest";
import { throttle } from "./throttle";

test("the first call is heard at once, and of those that follow too soon the newest", () => {
  vi.useFakeTimers();
  const heard: number[] = [];
  const listener = throttle<number>(100, (value) => heard.push(value));
  for (const value of [1, 2, 3]) listener(value);
  expect(heard).toEqual([1]);
  vi.advanceTimersByTime(101);
  expect(heard).toEqual([1, 3]);
  vi.advanceTimersByTime(500);
  expect(heard).toEqual([1, 3]);
  vi.useRealTimers();
});
