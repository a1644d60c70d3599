import { expect, test } from "vitest";
import { Newest } from "./newest";

test("one question at a time, and of those that wait only the newest", async () => {
  const asked: number[] = [];
  const answers: (() => void)[] = [];
  const newest = new Newest<number>((question) => {
    asked.push(question);
    return new Promise((resolve) => answers.push(resolve));
  });
  for (const question of [1, 2, 3, 4]) newest.put(question);
  expect(asked).toEqual([1]);
  expect(newest.overtaken).toBe(true);
  answers[0]?.();
  await Promise.resolve();
  await Promise.resolve();
  expect(asked).toEqual([1, 4]);
  expect(newest.overtaken).toBe(false);
});
