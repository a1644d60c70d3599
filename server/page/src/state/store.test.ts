import { expect, test } from "vitest";
import { Store } from "./store";

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

test("who left is told nothing more", () => {
  const s = store();
  const heard: number[] = [];
  s.subscribe((state) => state.count, (count) => heard.push(count))();
  s.set({ count: 5 });
  expect(heard).toEqual([0]);
});
