import { expect, test, vi } from "vitest";
import { emptyState, type State } from "./state";
import { setNotice, Store } from "./store";

interface Sample {
  count: number;
  part: { name: string; size: number };
}

const store = (): Store<Sample> => new Store<Sample>({ count: 0, part: { name: "a", size: 1 } });

test("tells the present value at once, and then only other ones", () => {
  const s = store();
  const heard: number[] = [];
  s.subscribe((state) => state.count, (count) => heard.push(count));
  s.set({ count: 1 });
  s.set({ count: 1 });
  s.patch("part", { size: 2 });
  expect(heard).toEqual([0, 1]);
});

test("a patch keeps the other fields and makes a new part", () => {
  const s = store();
  const before = s.state.part;
  s.patch("part", { size: 2 });
  expect(s.state.part).toEqual({ name: "a", size: 2 });
  expect(before).toEqual({ name: "a", size: 1 });
});

test("an ended subscription gets no more calls", () => {
  const s = store();
  const heard: number[] = [];
  s.subscribe((state) => state.count, (count) => heard.push(count))();
  s.set({ count: 5 });
  expect(heard).toEqual([0]);
});

test("one notice a key, replaced by a newer one and taken away by an empty one", () => {
  const store = new Store<State>(emptyState("ws://here"));
  setNotice(store, "a", "first");
  setNotice(store, "b", "other");
  setNotice(store, "a", "second");
  expect(store.state.notices.map(({ text }) => text)).toEqual(["other", "second"]);
  const before = store.state.notices;
  setNotice(store, "a", "second");
  expect(store.state.notices).toBe(before);
  setNotice(store, "a", "");
  setNotice(store, "b", "");
  expect(store.state.notices).toEqual([]);
});

test("a listener of several parts is called once a change of any of them", () => {
  const numbers = new Store({ one: 1, other: 2, third: 3 });
  const seen: number[] = [];
  numbers.subscribe(({ one, other }) => one + other, (sum) => void seen.push(sum));
  numbers.set({ one: 2, other: 3 });
  numbers.set({ third: 4 });
  expect(seen).toEqual([3, 5]);
});

test("the error of a listener keeps nothing from the others", () => {
  const s = store();
  const heard: number[] = [];
  const reported: unknown[] = [];
  vi.stubGlobal("reportError", (error: unknown) => reported.push(error));
  s.subscribe(({ count }) => count, (count) => {
    if (count > 0) throw new Error("broken");
  });
  s.subscribe(({ count }) => count, (count) => void heard.push(count));
  s.set({ count: 1 });
  vi.unstubAllGlobals();
  expect(heard).toEqual([0, 1]);
  expect(reported).toHaveLength(1);
});
