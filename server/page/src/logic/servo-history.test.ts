import { expect, test } from "vitest";
import type { ServoState } from "../state/state";
import { HISTORY_S, ServoHistories } from "./servo-history";

const servo = (name: string, values: Record<string, string>): ServoState => ({ name, hardware: "servo 1", level: 0, message: "", values });
const warm = (temperature_c: string): ServoState[] => [servo("elbow", { temperature_c, load: "-0.25" })];

test("temperature and load are kept, at times before now", () => {
  const histories = new ServoHistories();
  histories.record(warm("30"), 10);
  histories.record(warm("31"), 11);
  expect(histories.columns("elbow", 12)).toEqual([[-2, -1], [30, 31], [-25, -25]]);
});

test("no more is kept than ten minutes of it", () => {
  const histories = new ServoHistories();
  for (let second = 0; second < 3 * HISTORY_S; second += 1) histories.record(warm("30"), second);
  expect(histories.columns("elbow", 0)[0]).toHaveLength(HISTORY_S);
});

test("a servo that does not measure something has a gap there", () => {
  const histories = new ServoHistories();
  histories.record([servo("elbow", { load: "0.5" })], 1);
  expect(histories.columns("elbow", 1)).toEqual([[0], [null], [50]]);
  expect(histories.columns("none", 1)).toEqual([[], [], []]);
});

test("the server's history takes the place of what the page has seen, and goes on from there", () => {
  const histories = new ServoHistories();
  histories.record(warm("30"), 100);
  histories.replace("elbow", { time_s: [-3, -2], temperature_c: [25, 26], load: [], events: [] }, 101);
  histories.record(warm("31"), 101);
  expect(histories.columns("elbow", 101)).toEqual([[-3, -2, 0], [25, 26, 31], [null, null, -25]]);
});

test("servos that are gone are forgotten", () => {
  const histories = new ServoHistories();
  histories.record(warm("30"), 1);
  histories.record([], 2);
  expect(histories.columns("elbow", 2)[0]).toEqual([]);
});
