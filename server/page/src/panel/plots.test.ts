import { expect, test } from "vitest";
import { RingBuffer } from "./plots";

test("keeps the newest samples, oldest first", () => {
  const ring = new RingBuffer(1, 3);
  for (const second of [1, 2, 3, 4, 5]) ring.push(second, [second * 10]);
  expect(ring.columns()).toEqual([
    [3, 4, 5],
    [30, 40, 50],
  ]);
  expect(ring.newest_s).toBe(5);
});

test("a missing or invalid value is a gap", () => {
  const ring = new RingBuffer(2, 4);
  ring.push(1, [Number.NaN]);
  expect(ring.columns()).toEqual([[1], [null], [null]]);
});

test("time does not run back, until everything is forgotten", () => {
  const ring = new RingBuffer(1, 4);
  ring.push(5, [1]);
  ring.push(4, [2]);
  ring.push(5, [3]);
  expect(ring.columns()).toEqual([[5], [1]]);
  ring.clear();
  ring.push(1, [4]);
  expect(ring.columns()).toEqual([[1], [4]]);
});
