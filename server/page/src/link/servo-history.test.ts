import { expect, test } from "vitest";
import type { Connection } from "./connection";
import { fetchServoHistory } from "./servo-history";

const asked = (response: unknown): Promise<unknown> => {
  const call = (): Promise<unknown> => (response === null ? Promise.reject(new Error("no service")) : Promise.resolve(response));
  return fetchServoHistory({ call } as unknown as Connection, "elbow");
};

test("the history is read with NaN for what was not measured", async () => {
  const response = { time_s: [-2, -1], temperature_c: [30, null], load: [], voltage_v: [], current_a: [], events: ["hot"] };
  const history = { time_s: [-2, -1], temperature_c: [30, Number.NaN], load: [], events: ["hot"] };
  expect(await asked(response)).toEqual(history);
});

test("a server without the service, and one without a history, are no error", async () => {
  expect(await asked(null)).toBeNull();
  expect(await asked({ time_s: [], temperature_c: [], load: [], events: [] })).toBeNull();
});
