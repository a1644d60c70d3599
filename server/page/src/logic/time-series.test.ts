import { describe, expect, it, test } from "vitest";
import { TimeSeries } from "./time-series";

const columns = (series: TimeSeries): (number | null)[][] => series.span(-Infinity, Infinity, [...Array(series.curves).keys()]);

test("keeps the newest samples, oldest first, and drops older ones many at a time", () => {
  const series = new TimeSeries(1, 10);
  for (let second = 1; second <= 11; second += 1) series.push(second, [second * 10]);
  expect(series.times_s[0]).toBe(1);
  series.push(12, [120]);
  expect(columns(series)[0]).toEqual([3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
  expect(columns(series)[1]?.slice(-2)).toEqual([110, 120]);
});

test("a missing or invalid value is a gap", () => {
  const series = new TimeSeries(2, 4);
  series.push(1, [Number.NaN]);
  expect(columns(series)).toEqual([[1], [null], [null]]);
});

test("time does not run back, until everything is forgotten", () => {
  const series = new TimeSeries(1, 4);
  series.push(5, [1]);
  series.push(4, [2]);
  series.push(5, [3]);
  expect(columns(series)).toEqual([[5], [1]]);
  series.clear();
  series.push(1, [4]);
  expect(columns(series)).toEqual([[1], [4]]);
});

describe("span", () => {
  const filled = (count: number, capacity: number): TimeSeries => {
    const series = new TimeSeries(2, capacity);
    for (let index = 0; index < count; index += 1) series.push(index, [10 * index, -index]);
    return series;
  };

  it("has the samples of a span, one more at either side so that the line does not end in the picture", () => {
    expect(filled(12, 20).span(6, 8, [1])).toEqual([
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
    expect(new TimeSeries(1, 4).span(0, 1, [0])).toEqual([[], []]);
  });

  it("keeps a peak of one sample among many", () => {
    const series = new TimeSeries(1, 10_000);
    for (let index = 0; index < 9000; index += 1) series.push(index, [index === 4321 ? 99 : 0]);
    const [times = [], values = []] = series.span(0, 9000, [0], 600);
    expect(times.length).toBeLessThanOrEqual(602);
    expect(Math.max(...values.map(Number))).toBe(99);
  });
});
