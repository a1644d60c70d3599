import { expect, test, vi } from "vitest";
import { emptyState } from "../state/state";
import { selectGoal, selectTarget, Store, type PageStore } from "../state/store";
import type { Connection } from "./connection";
import { checkReachability, latestOnly } from "./reachability";

test("one question at a time, and of those that wait only the newest", async () => {
  const asked: number[] = [];
  const answers: (() => void)[] = [];
  const put = latestOnly<number>((request) => {
    asked.push(request);
    return new Promise((resolve) => answers.push(resolve));
  });
  for (const request of [1, 2, 3, 4]) put(request);
  expect(asked).toEqual([1]);
  answers[0]?.();
  await Promise.resolve();
  await Promise.resolve();
  expect(asked).toEqual([1, 4]);
});

function checked(): { store: PageStore; asked: () => number; link: { connected: boolean } } {
  const store = new Store(emptyState("ws://here"));
  const link = { connected: true };
  const call = vi.fn(() => (link.connected ? Promise.resolve({ results: [] }) : Promise.reject(new Error("offline"))));
  checkReachability({ call } as unknown as Connection, store);
  return { store, asked: () => call.mock.calls.length, link };
}

const settled = (): Promise<void> => new Promise((resolve) => setTimeout(resolve));

test("a target that nobody could answer for is asked about when the server is back", async () => {
  const { store, asked, link } = checked();
  link.connected = false;
  selectTarget(store, [0.2, 0, 0.2]);
  await settled();
  expect(asked()).toBe(1);
  link.connected = true;
  store.patch("link", { connected: true });
  await settled();
  expect(asked()).toBe(2);
});

test("a point that is no target any more is not", async () => {
  const { store, asked } = checked();
  selectTarget(store, [0.2, 0, 0.2]);
  await settled();
  selectGoal(store, "none", null);
  store.patch("link", { connected: true });
  await settled();
  expect(asked()).toBe(1);
});

test("a target that had no answer in time is asked about again while it is the target", async () => {
  vi.useFakeTimers();
  const { store, asked, link } = checked();
  store.patch("link", { connected: true });
  link.connected = false;
  selectTarget(store, [0.2, 0, 0.2]);
  await vi.advanceTimersByTimeAsync(1500);
  expect(asked()).toBe(2);
  selectGoal(store, "none", null);
  await vi.advanceTimersByTimeAsync(5000);
  expect(asked()).toBe(2);
  vi.useRealTimers();
});
