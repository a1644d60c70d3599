import type { JointGroup, RobotInfo } from "./robot-info";

/** Return a robot of some groups, the first of which is the default; a group has no gripper unless it names one. */
export function robotOf(...groups: (Partial<JointGroup> & { name: string })[]): RobotInfo {
  const whole = groups.map((group) => ({ joints: [], tip: "tip", touch_links: [], namespace: "", gripper: null, ...group }));
  return { joints: {}, default_group: groups[0]?.name ?? "", groups: whole, reach_m: 1 };
}

/** Robot of an arm with one joint, whose two fingers slide. */
export const WITH_FINGERS: RobotInfo = robotOf({ name: "arm", joints: ["a"], gripper: { joints: ["left"], open: 0.06, closed: 0, action: "/gripper_controller/gripper_cmd" } });

/** Robot of two arms of one joint each, and of both. */
export const TWO_ARMS: RobotInfo = robotOf(
  { name: "left_arm", joints: ["left_a"], namespace: "/left" },
  { name: "right_arm", joints: ["right_a"], namespace: "/right" },
  { name: "both_arms", joints: ["left_a", "right_a"], namespace: null, tip: null },
);
