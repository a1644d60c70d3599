import { expect, test } from "vitest";
import type { Control, Identity } from "../state/state";
import { controlHolder, controlText, denialReason } from "./permissions";

const me = (role: Identity["role"]): Identity => ({ address: "10.0.0.1:5", role, version: "" });
const FREE: Control = { holder: "", address: "", policy: "lease", free_in_s: null };
const MINE: Control = { holder: "alice (10.0.0.1:5)", address: "10.0.0.1:5", policy: "lease", free_in_s: 10 };
const OTHERS: Control = { holder: "bob (10.0.0.1:6)", address: "10.0.0.1:6", policy: "lease", free_in_s: 7 };

test("an operator may move the arm while nobody or the page itself controls it", () => {
  for (const control of [FREE, MINE]) expect(denialReason("drive", { identity: me("operate"), control })).toBe("");
});

test("while another drives all but driving is open", () => {
  const state = { identity: me("admin"), control: OTHERS };
  expect(denialReason("drive", state)).toBe("bob (10.0.0.1:6) controls the arm.");
  expect([denialReason("work", state), denialReason("configure", state)]).toEqual(["", ""]);
});

test("each role may do what those before it may", () => {
  const open = (role: Identity["role"]): boolean[] => {
    return (["drive", "work", "configure"] as const).map((operation) => denialReason(operation, { identity: me(role), control: FREE }) === "");
  };
  for (const role of ["view", "propose"] as const) expect(open(role)).toEqual([false, false, false]);
  expect(open("operate")).toEqual([true, true, false]);
  expect(open("admin")).toEqual([true, true, true]);
});

test("a role that is too little is told with the one that it takes", () => {
  const sentence = denialReason("configure", { identity: me("operate"), control: FREE });
  expect(sentence).toBe("This page has the role operate: for this it needs a token with the role admin.");
});

test("nothing is greyed before the server has told who the page is", () => {
  expect(denialReason("drive", { identity: null, control: OTHERS })).toBe("");
});

test("under shared control nothing is denied", () => {
  const state = { identity: me("operate"), control: { ...FREE, policy: "shared" as const } };
  expect([denialReason("drive", state), controlHolder(state), controlText(state)]).toEqual(["", "nobody", ""]);
});

test("the sentence says who drives and when the arm is free", () => {
  const sentence = (control: Control): string => controlText({ identity: me("operate"), control });
  expect(sentence(FREE)).toBe("Nobody controls the arm.");
  expect(sentence(MINE)).toBe("This page controls the arm.");
  expect(sentence(OTHERS)).toBe("bob (10.0.0.1:6) controls the arm. It is free in 7 s if nothing more is asked of it.");
});

test("a viewer reads that it may only look", () => {
  const sentence = controlText({ identity: me("view"), control: FREE });
  expect(sentence).toBe("Read only: the role view lets this page look, and stop the arm. Nobody controls the arm.");
});
