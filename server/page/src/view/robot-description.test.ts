import { describe, expect, it } from "vitest";
import { descriptionProblem, farthestLink, hasNumbers } from "./robot-description";

const JOINT = { name: "pan", parent: "base", child: "arm", mimic: null };
const GOOD = { links: ["base", "arm"], joints: [JOINT], without_shape: [], without_numbers: [] };

describe("descriptionProblem", () => {
  it("accepts a tree", () => {
    expect(descriptionProblem(GOOD)).toBe("");
  });
  it.each([
    ["no links", { ...GOOD, links: [], joints: [] }, "no <link>"],
    ["unknown link", { ...GOOD, joints: [{ ...JOINT, child: "hand" }] }, '"hand"'],
    ["two roots", { ...GOOD, joints: [] }, "base, arm"],
    ["two parents", { ...GOOD, joints: [JOINT, { ...JOINT, name: "tilt" }] }, "two joints"],
    ["unknown mimic", { ...GOOD, joints: [{ ...JOINT, mimic: "jaw" }] }, '"jaw"'],
    ["loop", { ...GOOD, joints: [JOINT, { ...JOINT, name: "b", parent: "arm", child: "base" }] }, "none"],
    ["no numbers", { ...GOOD, without_numbers: ['link "arm": <box size="x">'] }, "no numbers"],
    ["no shape", { ...GOOD, without_shape: ["arm"] }, "<geometry>"],
  ])("refuses %s", (_, parts, sentence) => {
    expect(descriptionProblem(parts)).toContain(sentence);
  });
});

describe("hasNumbers", () => {
  it("counts them", () => {
    expect(hasNumbers(" 0 1e-3  -2.5 ", 3)).toBe(true);
    expect([null, "", "1 2", "1 2 x", "1 2 NaN"].map((text) => hasNumbers(text, 3))).toEqual(Array(5).fill(false));
  });
});

describe("farthestLink", () => {
  it("is the tip of a robot without groups", () => {
    expect(farthestLink(GOOD)).toBe("arm");
    expect(farthestLink({ ...GOOD, links: [] , joints: [] })).toBeNull();
  });
});

