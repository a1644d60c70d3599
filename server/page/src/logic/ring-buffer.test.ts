import { describe, expect, it, test } from "vitest";
import { RingBuffer } from "./ring-buffer";

const columns = (ring: RingBuffer): (number | null)[][] => ring.span(-Infinity, Infinity, [...Array(ring.curves).keys()]);

test("keeps the newest samples, oldest first", () => {
  const ring = new RingBuffer(1, 3);
  for (const second of [1, 2, 3, 4, 5]) ring.push(second, [second * 10]);
  expect(columns(ring)).toEqual([
    [3, 4, 5],
    [30, 40, 50],
  ]);
  expect(ring.newest_s).toBe(5);
});

test("a missing or invalid value is a gap", () => {
  const ring = new RingBuffer(2, 4);
  ring.push(1, [Number.NaN]);
  expect(columns(ring)).toEqual([[1], [null], [null]]);
});

test("time does not run back, until everything is forgotten", () => {
  const ring = new RingBuffer(1, 4);
  ring.push(5, [1]);
  ring.push(4, [2]);
  ring.push(5, [3]);
  expect(columns(ring)).toEqual([[5], [1]]);
  ring.clear();
  ring.push(1, [4]);
  expect(columns(ring)).toEqual([[1], [4]]);
});

describe("span", () => {
  const filled = (count: number, capacity: number): RingBuffer => {
    const ring = new RingBuffer(2, capacity);
    for (let index = 0; index < count; index += 1) ring.push(index, [10 * index, -index]);
    return ring;
  };

  it("has the samples of a span, one more at either side so that the line does not end in the picture", () => {
    expect(filled(12, 8).span(6, 8, [1])).toEqual([
      [5, 6, 7, 8],
      [-5, -6, -7, -8],
    ]);
  });

  it("has the curves that were asked for", () => {
    expect(filled(3, 8).span(1, 9, [1, 0]).map((row) => row.slice(1))).toEqual([
      [1, 2],
      [-1, -2],
      [10, 20],
    ]);
  });

  it("is empty before the first sample", () => {
    expect(new RingBuffer(1, 4).span(0, 1, [0])).toEqual([[], []]);
  });

  it("keeps a peak of one sample among many", () => {
    const ring = new RingBuffer(1, 10_000);
    for (let index = 0; index < 9000; index += 1) ring.push(index, [index === 4321 ? 99 : 0]);
    const [times = [], values = []] = ring.span(0, 9000, [0], 600);
    expect(times.length).toBeLessThanOrEqual(602);
    expect(Math.max(...values.map(Number))).toBe(99);
  });
});

test("the oldest time is that of the oldest sample that is kept", () => {
  const ring = new RingBuffer(1, 2);
  expect(ring.oldest_s).toBeNaN();
  for (const time_s of [1, 2, 3]) ring.push(time_s, [0]);
  expect(ring.oldest_s).toBe(2);
});
