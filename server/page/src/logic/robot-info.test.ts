import { expect, test } from "vitest";
import { emptyState } from "../state/state";
import { planningGroup, robotInfo } from "./robot-info";

const joint = (name: string, type: string, parent: string, child: string, inside = ""): string =>
  `<joint name="${name}" type="${type}"><parent link="${parent}"/><child link="${child}"/>${inside}</joint>`;
const LIMIT = '<limit lower="-1" upper="2" velocity="1" effort="1"/>';

/** A lift, a wheel and an arm, whose two fingers carry a third that follows one of them. */
const URDF = `<robot name="r">
  ${joint("lift", "prismatic", "base", "column", '<limit lower="0" upper="0.4" velocity="1" effort="1"/>')}
  ${joint("turn", "continuous", "column", "shoulder")}
  ${joint("bend", "revolute", "shoulder", "fore", LIMIT)}
  ${joint("mount", "fixed", "fore", "hand")}
  ${joint("left", "prismatic", "hand", "left_finger", '<limit lower="0" upper="0.05" velocity="1" effort="1"/>')}
  ${joint("right", "prismatic", "hand", "right_finger", '<limit lower="0" upper="0.05" velocity="1" effort="1"/>')}
  ${joint("tip", "prismatic", "left_finger", "tip", '<limit lower="0" upper="1"/><mimic joint="left"/>')}
</robot>`;

const SRDF = `<robot name="r">
  <group name="fingers"><joint name="left"/><joint name="right"/><joint name="tip"/></group>
  <group name="upper"><chain base_link="column" tip_link="hand"/></group>
  <group name="whole"><joint name="lift"/><group name="upper"/></group>
  <group name="links"><link name="column"/><link name="fore"/></group>
  <group name="nothing"/>
  <end_effector name="hand" parent_link="hand" group="fingers" parent_group="upper"/>
  <group_state name="hand_open" group="fingers"><joint name="left" value="0.04"/><joint name="right" value="0.04"/></group_state>
</robot>`;

const state = (group = "", srdf: string | null = SRDF) => ({ ...emptyState("ws://here"), urdf: URDF, srdf, group });

test("joints have their kinds and limits; those that follow others or are fixed are none", () => {
  const { joints } = robotInfo(state());
  expect([...joints.keys()]).toEqual(["lift", "turn", "bend", "left", "right"]);
  expect(joints.get("lift")).toEqual({ name: "lift", kind: "prismatic", limits: [0, 0.4] });
  expect(joints.get("turn")).toEqual({ name: "turn", kind: "continuous", limits: [-Math.PI, Math.PI] });
});

test("groups are chains, joints, links and groups, and those of grippers are no groups to plan for", () => {
  expect(robotInfo(state()).groups).toEqual([
    { name: "upper", joints: ["turn", "bend"], tip: "hand" },
    { name: "whole", joints: ["lift", "turn", "bend"], tip: "hand" },
    { name: "links", joints: ["lift", "bend"], tip: "fore" },
  ]);
});

test("a group of several arms has no tip, and one of links behind each other has the last", () => {
  const groups = `<group name="one"><joint name="left"/></group><group name="other"><joint name="right"/></group>
    <group name="both"><group name="one"/><group name="other"/></group><group name="chain"><group name="one"/><group name="upper"/></group>`;
  const srdf = SRDF.replace("</robot>", `${groups}</robot>`).replace(/<end_effector.*/, "");
  const tip = (name: string): unknown => planningGroup(state(name, srdf))?.tip;
  expect([tip("both"), tip("chain")]).toEqual([null, "hand"]);
});

test("the selected group counts, else the group arm, else the first", () => {
  expect(planningGroup(state("whole"))?.name).toBe("whole");
  expect(planningGroup(state("gone"))?.name).toBe("upper");
  const with_arm = SRDF.replace('name="whole"', 'name="arm"');
  expect(planningGroup(state("", with_arm))?.name).toBe("arm");
  expect(planningGroup(state("", null))).toBeNull();
});

test("a gripper of two fingers opens to the state of its group, and closes to the limit without one", () => {
  const gripper = { group: "fingers", joints: ["left", "right"], open: 0.04, closed: 0 };
  expect(robotInfo(state()).grippers).toEqual([{ parent_group: "upper", gripper }]);
});

test("without an end effector a group is a gripper by its name, unless it is the only one", () => {
  const hand = '<robot><group name="my_hand"><joint name="left"/></group>';
  const other = '<group name="a"><joint name="bend"/></group></robot>';
  expect(robotInfo(state("", `${hand}${other}`)).grippers).toHaveLength(1);
  expect(robotInfo(state("", `${hand}${other}`)).groups.map(({ name }) => name)).toEqual(["a"]);
  expect(robotInfo(state("", `${hand}</robot>`)).grippers).toEqual([]);
});

test("a passive joint is not moved", () => {
  const srdf = SRDF.replace("</robot>", '<passive_joint name="turn"/></robot>');
  expect(planningGroup(state("upper", srdf))?.joints).toEqual(["bend"]);
});

test.each([
  ["a group that contains itself", '<robot><group name="a"><group name="a"/><joint name="bend"/></group></robot>'],
  ["a chain that leads nowhere", '<robot><group name="a"><chain base_link="no" tip_link="hand"/></group></robot>'],
  ["no XML", "<robot"],
])("%s ends", (_, srdf) => {
  expect(robotInfo(state("", srdf)).joints.size).toBe(5);
});
