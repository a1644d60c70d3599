import { expect, test, vi } from "vitest";
import { emptyState, type State } from "../state/state";
import { Store } from "../state/store";
import { wish, wishPoint } from "../state/wishes";
import type { Link } from "./link";
import { checkTargets } from "./target-check";

function checked(): { store: Store<State>; asked: () => number; link: { isConnected: boolean } } {
  const store = new Store(emptyState("ws://here"));
  const call = vi.fn(() => Promise.resolve({ results: [] }));
  const link = { isConnected: true, call };
  checkTargets(link as unknown as Link, store);
  return { store, asked: () => call.mock.calls.length, link };
}

const settled = (): Promise<void> => new Promise((resolve) => setTimeout(resolve));

test("a target that nobody could answer for is asked about when the server is back", async () => {
  const { store, asked, link } = checked();
  link.isConnected = false;
  wishPoint(store, [0.2, 0, 0.2]);
  await settled();
  expect(asked()).toBe(0);
  link.isConnected = true;
  store.patch("link", { connected: true });
  await settled();
  expect(asked()).toBe(1);
});

test("a point that is no target any more is not", async () => {
  const { store, asked } = checked();
  wishPoint(store, [0.2, 0, 0.2]);
  await settled();
  wish(store, "none", null);
  store.patch("link", { connected: true });
  await settled();
  expect(asked()).toBe(1);
});
