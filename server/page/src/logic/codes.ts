/** The names of moveit_msgs/MoveItErrorCodes, in MoveIt's spelling. */
const NAMES: Record<number, string> = {
  1: "SUCCESS",
  0: "UNDEFINED",
  99999: "FAILURE",
  [-1]: "PLANNING_FAILED",
  [-2]: "INVALID_MOTION_PLAN",
  [-3]: "MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE",
  [-4]: "CONTROL_FAILED",
  [-5]: "UNABLE_TO_AQUIRE_SENSOR_DATA",
  [-6]: "TIMED_OUT",
  [-7]: "PREEMPTED",
  [-10]: "START_STATE_IN_COLLISION",
  [-11]: "START_STATE_VIOLATES_PATH_CONSTRAINTS",
  [-12]: "GOAL_IN_COLLISION",
  [-13]: "GOAL_VIOLATES_PATH_CONSTRAINTS",
  [-14]: "GOAL_CONSTRAINTS_VIOLATED",
  [-15]: "INVALID_GROUP_NAME",
  [-16]: "INVALID_GOAL_CONSTRAINTS",
  [-17]: "INVALID_ROBOT_STATE",
  [-18]: "INVALID_LINK_NAME",
  [-19]: "INVALID_OBJECT_NAME",
  [-21]: "FRAME_TRANSFORM_FAILURE",
  [-22]: "COLLISION_CHECKING_UNAVAILABLE",
  [-23]: "ROBOT_STATE_STALE",
  [-24]: "SENSOR_INFO_STALE",
  [-25]: "COMMUNICATION_FAILURE",
  [-26]: "START_STATE_INVALID",
  [-27]: "GOAL_STATE_INVALID",
  [-28]: "UNRECOGNIZED_GOAL_TYPE",
  [-29]: "CRASH",
  [-30]: "ABORT",
  [-31]: "NO_IK_SOLUTION",
};

/** MoveIt's code of a motion that ended well. */
export const SUCCESS = 1;

/** MoveIt's code of a goal that was stopped, or gave way to another. */
export const PREEMPTED = -7;

/** A code as people know it: `NO_IK_SOLUTION`, or `code -99` when nobody does. */
export function codeName(code: number): string {
  return NAMES[code] ?? `code ${code}`;
}
