import { expect, test } from "vitest";
import { setNotice } from "./notices";
import { emptyState, type State } from "./state";
import { Store } from "./store";

test("one notice a key, replaced by a newer one and taken away by an empty one", () => {
  const store = new Store<State>(emptyState("ws://here"));
  setNotice(store, "a", "first");
  setNotice(store, "b", "other");
  setNotice(store, "a", "second");
  expect(store.state.notices.map(({ text }) => text)).toEqual(["other", "second"]);
  const before = store.state;
  setNotice(store, "a", "second");
  expect(store.state).toBe(before);
  setNotice(store, "a", "");
  setNotice(store, "b", "");
  expect(store.state.notices).toEqual([]);
});
