import { expect, test } from "vitest";
import type { Control, Identity } from "../state/state";
import { controlSentence, hindrance, holder } from "./rights";

const me = (role: Identity["role"]): Identity => ({ address: "10.0.0.1:5", role });
const FREE: Control = { holder: "", address: "", policy: "lease", free_in_s: null };
const MINE: Control = { holder: "alice (10.0.0.1:5)", address: "10.0.0.1:5", policy: "lease", free_in_s: 10 };
const OTHERS: Control = { holder: "bob (10.0.0.1:6)", address: "10.0.0.1:6", policy: "lease", free_in_s: 7 };

test("who operates drives while nobody does, or the page itself", () => {
  for (const control of [FREE, MINE]) expect(hindrance("drive", { identity: me("operate"), control })).toBe("");
});

test("while another drives all but driving is open", () => {
  const state = { identity: me("admin"), control: OTHERS };
  expect(hindrance("drive", state)).toBe("bob (10.0.0.1:6) controls the arm.");
  expect([hindrance("work", state), hindrance("configure", state)]).toEqual(["", ""]);
});

test("each role may do what those before it may", () => {
  const open = (role: Identity["role"]): boolean[] => {
    return (["drive", "work", "configure"] as const).map((deed) => hindrance(deed, { identity: me(role), control: FREE }) === "");
  };
  expect(open("view")).toEqual([false, false, false]);
  expect(open("operate")).toEqual([true, true, false]);
  expect(open("admin")).toEqual([true, true, true]);
});

test("a role that is too little is told with the one that it takes", () => {
  const sentence = hindrance("configure", { identity: me("operate"), control: FREE });
  expect(sentence).toBe("This page has the role operate: for this it needs a token with the role admin.");
});

test("nothing is greyed before the server has told who the page is", () => {
  expect(hindrance("drive", { identity: null, control: OTHERS })).toBe("");
});

test("where all may drive at once nobody is in the way", () => {
  const state = { identity: me("operate"), control: { ...FREE, policy: "shared" as const } };
  expect([hindrance("drive", state), holder(state), controlSentence(state)]).toEqual(["", "nobody", ""]);
});

test("the sentence says who drives and when the arm is free", () => {
  const sentence = (control: Control): string => controlSentence({ identity: me("operate"), control });
  expect(sentence(FREE)).toBe("Nobody controls the arm.");
  expect(sentence(MINE)).toBe("This page controls the arm.");
  expect(sentence(OTHERS)).toBe("bob (10.0.0.1:6) controls the arm. It is free in 7 s if nothing more is asked of it.");
});

test("who may only look is told so", () => {
  const sentence = controlSentence({ identity: me("view"), control: FREE });
  expect(sentence).toBe("Read only: the role view lets this page look, and stop the arm. Nobody controls the arm.");
});
