import { describe, expect, it } from "vitest";
import { bounds, MAX_SPAN_S, MIN_SPAN_S, panned, zoomed } from "./time-window";

const EXTENT = { oldest_s: 100, newest_s: 200 };
const LIVE = { span_s: 20, end_s: null };
const HALTED = { span_s: 20, end_s: 180 };

describe("a live window", () => {
  it("ends at the newest sample", () => expect(bounds(LIVE, EXTENT)).toEqual([180, 200]));
  it("stays live when zoomed", () => expect(zoomed(LIVE, 0.5, 190, EXTENT)).toEqual({ span_s: 10, end_s: null }));
  it("halts when it is dragged into the past", () => expect(panned(LIVE, -5, EXTENT)).toEqual({ span_s: 20, end_s: 195 }));
});

describe("a halted window", () => {
  it("is never moved forwards on the way back, however little there is to see", () => {
    const short = { oldest_s: 199, newest_s: 200 };
    expect(panned({ span_s: 20, end_s: 199.5 }, -2, short)).toEqual({ span_s: 20, end_s: 199.5 });
  });
  it("keeps the time under the pointer in its place", () => {
    const { span_s, end_s } = zoomed(HALTED, 0.5, 165, EXTENT);
    expect([span_s, end_s]).toEqual([10, 172.5]);
  });
  it("does not go beyond the newest sample", () => expect(panned(HALTED, 50, EXTENT).end_s).toBe(200));
  it("keeps some samples in sight at the other end", () => expect(panned(HALTED, -500, EXTENT).end_s).toBe(102));
});

describe("the span", () => {
  it("has a least length", () => expect(zoomed(HALTED, 1e-6, 170, EXTENT).span_s).toBe(MIN_SPAN_S));
  it("has a greatest length", () => expect(zoomed(HALTED, 1e6, 170, EXTENT).span_s).toBe(MAX_SPAN_S));
});
