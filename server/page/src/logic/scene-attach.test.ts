import { expect, test } from "vitest";
import { holderOf } from "./scene-attach";

const joint = (name: string, type: string, parent: string, child: string): string =>
  `<joint name="${name}" type="${type}"><parent link="${parent}"/><child link="${child}"/></joint>`;
const URDF = `<robot name="r">${joint("lift", "revolute", "base", "palm")}${joint("tool", "fixed", "palm", "tip")}
${joint("finger", "revolute", "palm", "jaw")}${joint("other", "revolute", "base", "tail")}</robot>`;
const GROUPS = `<group name="arm"><chain base_link="base" tip_link="tip"/></group><group name="hand"><joint name="finger"/></group>`;

test("the end effector's parent holds, and its group and what is fixed to it may touch", () => {
  const srdf = `<robot>${GROUPS}<end_effector name="e" parent_link="tip" group="hand" parent_group="arm"/></robot>`;
  expect(holderOf({ urdf: URDF, srdf, group: "arm" })).toEqual({ link: "tip", touch_links: ["tip", "palm", "jaw"] });
});

test("without an end effector the group's tip holds", () => {
  const srdf = `<robot>${GROUPS}</robot>`;
  expect(holderOf({ urdf: URDF, srdf, group: "arm" })).toEqual({ link: "tip", touch_links: ["tip", "palm"] });
});

test("fingers may be links or a chain", () => {
  const fingers = `<group name="hand"><link name="tail"/><chain base_link="base" tip_link="jaw"/></group>`;
  const srdf = `<robot><group name="arm"><chain base_link="base" tip_link="tip"/></group>${fingers}
    <end_effector name="e" parent_link="tip" group="hand" parent_group="arm"/></robot>`;
  expect(holderOf({ urdf: URDF, srdf, group: "arm" })?.touch_links).toEqual(["tip", "palm", "tail", "jaw"]);
});

test("nothing holds before the robot is known", () => {
  expect(holderOf({ urdf: null, srdf: null, group: "" })).toBeNull();
});
