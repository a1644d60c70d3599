import type { JointValues, Point, State } from "../state/state";

/** A header in a frame, with the stamp that means "now" here. */
function header(frame_id: string): object {
  return { stamp: { sec: 0, nanosec: 0 }, frame_id };
}

function pose([x, y, z]: Point): object {
  return { position: { x, y, z }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
}

/** geometry_msgs/PoseStamped in the root link, which an empty frame means. */
export function poseStamped(position_m: Point): object {
  return { header: header(""), pose: pose(position_m) };
}

/** moveit_msgs/Constraints: these joints at these positions. */
export function jointGoal(joints_rad: JointValues): object {
  const joint_constraints = Object.entries(joints_rad).map(([joint_name, position]) => ({
    joint_name,
    position,
    // Room for the rounding on the way; the planner goes to the middle.
    tolerance_above: 1e-4,
    tolerance_below: 1e-4,
    weight: 1,
  }));
  return { joint_constraints };
}

/** moveit_msgs/Constraints: the tip, which an empty link name means, within a ball. */
export function pointGoal(position_m: Point, radius_m: number): object {
  const sphere = { type: 2, dimensions: [radius_m] };
  const constraint_region = { primitives: [sphere], primitive_poses: [pose(position_m)] };
  return { position_constraints: [{ header: header(""), link_name: "", constraint_region, weight: 1 }] };
}

/** How near the tip has to come to a point that was asked for [m]; what /moveit_goal_pose takes. */
const POINT_TOLERANCE_M = 0.01;

/** moveit_msgs/MotionPlanRequest of constraints; the empty group is the configured one. */
export function motionRequest(constraints: object, speed: number): object {
  return {
    group_name: "",
    goal_constraints: [constraints],
    max_velocity_scaling_factor: speed,
    max_acceleration_scaling_factor: speed,
  };
}

/** The goal of /move_action. */
export function moveGroupGoal(constraints: object, speed: number, plan_only: boolean): object {
  return { request: motionRequest(constraints, speed), planning_options: { plan_only } };
}

/** What the user wants, as moveit_msgs/Constraints; null when nothing was chosen yet. */
export function wishedGoal({ wish, target }: Pick<State, "wish" | "target">): object | null {
  if (wish.kind === "none") return null;
  if (wish.kind !== "target") return wish.joints_rad && jointGoal(wish.joints_rad);
  if (!target.position_m) return null;
  // What the ghost shows is what will be: the configuration, not just any for that point.
  if (target.reachable && target.joints_rad) return jointGoal(target.joints_rad);
  return pointGoal(target.position_m, POINT_TOLERANCE_M);
}

/** armbridge_msgs/srv/CheckGoals about one point. */
export function checkPoint(position_m: Point): object {
  return { poses: [poseStamped(position_m)], joints: [] };
}

/** The goal of GripperCommand; an effort of 0 is the most that the gripper may use. */
export function gripperGoal(position_rad: number): object {
  return { command: { position: position_rad, max_effort: 0 } };
}

/** moveit_msgs/CollisionObject ADD: a box in the root link. */
export function addBox(id: string, position_m: Point, size_m: Point): object {
  const box = { type: 1, dimensions: [...size_m] };
  return { header: header(""), id, pose: pose(position_m), primitives: [box], primitive_poses: [pose([0, 0, 0])], operation: 0 };
}

/** moveit_msgs/CollisionObject MOVE: the thing at another place in the root link, turned as it was. */
export function moveObject(id: string, position_m: Point, orientation: [number, number, number, number]): object {
  const [x, y, z] = position_m;
  const [qx, qy, qz, qw] = orientation;
  const moved = { position: { x, y, z }, orientation: { x: qx, y: qy, z: qz, w: qw } };
  return { header: header(""), id, pose: moved, operation: 3 };
}

/** moveit_msgs/CollisionObject REMOVE. */
export function removeObject(id: string): object {
  return { header: header(""), id, operation: 1 };
}

/** control_msgs/JointJog: shares of the servo's joint speed, -1 to 1. */
export function jointJog(velocities: JointValues): object {
  return {
    header: header(""),
    joint_names: Object.keys(velocities),
    displacements: [],
    velocities: Object.values(velocities),
    duration: 0,
  };
}
