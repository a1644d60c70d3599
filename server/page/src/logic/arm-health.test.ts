import { expect, it, describe } from "vitest";
import { healthRows, type HealthRow } from "./arm-health";

const ON_BUS = {
  port: "/dev/ttyUSB0",
  real_time_priority: "true",
  real_time_factor: "1.00",
  loop_lateness_ms: "p50 0.050, p99 0.200, max 3.100",
  bus_round_trip_ms: "p50 1.250, p99 2.000, max 4.000",
  bus_sent: "1000",
  bus_timeouts: "0",
  bus_retries: "0",
  bus_discarded_bytes: "0",
};

function row(id: HealthRow["id"], values: Record<string, string>, latency_ms: number | null = 1): HealthRow | undefined {
  return healthRows({ level: 0, message: "", values }, latency_ms).find((each) => each.id === id);
}

describe("health", () => {
  it.each([
    ["a quick network", "latency", {}, 1.23, "health.latency.good", false],
    ["a slow network", "latency", {}, 80, "health.latency.slow", true],
    ["no answer yet", "latency", {}, null, "health.latency.none", false],
    ["a punctual loop", "loop", ON_BUS, 1, "health.loop.text", false],
    ["a late loop", "loop", { loop_lateness_ms: "p50 0.1, p99 12.0, max 30.0" }, 1, "health.loop.late", true],
    ["a simulation", "bus", { port: "sim" }, 1, "health.bus.simulated", false],
    ["a simulated bus", "bus", { ...ON_BUS, bus_round_trip_ms: "p50 0.000, p99 0.000, max 0.000" }, 1, "health.bus.simulated", false],
    ["a bus", "bus", ON_BUS, 1, "health.bus.text", false],
    ["every answer", "answers", ON_BUS, 1, "health.answers.good", false],
    ["few lost answers", "answers", { ...ON_BUS, bus_timeouts: "20" }, 1, "health.answers.few", false],
    ["many lost answers", "answers", { ...ON_BUS, bus_timeouts: "21" }, 1, "health.answers.lost", true],
    ["a slow simulation", "machine", { ...ON_BUS, real_time_factor: "0.50" }, 1, "health.machine.real_time", true],
  ] as const)("tells of %s", (_, id, values, latency_ms, key, warn) => {
    const found = row(id, values as Record<string, string>, latency_ms);
    expect([found?.texts[0]?.[0], found?.warn]).toEqual([key, warn]);
  });

  it("has the typical and the greatest lateness", () => {
    expect(row("loop", ON_BUS)?.texts[0]?.[1]).toEqual({ typical: "0.05", greatest: "3.1" });
  });

  it("leaves out what the server does not tell", () => {
    expect(healthRows({ level: 0, message: "", values: {} }, 1).map(({ id }) => id)).toEqual(["latency"]);
  });
});
