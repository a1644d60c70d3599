/** Messages as they come, in ROS 2 spelling; a number that JSON cannot write comes as null. */

/** builtin_interfaces/Time. */
export interface Time {
  sec: number;
  nanosec: number;
}

/** std_msgs/String. */
export interface Text {
  data: string;
}

/** sensor_msgs/JointState. */
export interface JointState {
  header: { stamp: Time };
  name: string[];
  position: (number | null)[];
  velocity: (number | null)[];
  effort: (number | null)[];
}

/** diagnostic_msgs/DiagnosticStatus. */
export interface DiagnosticStatus {
  level: number;
  name: string;
  message: string;
  hardware_id: string;
  values: { key: string; value: string }[];
}

/** moveit_msgs/KinematicSolverInfo. */
export interface KinematicSolverInfo {
  joint_names: string[];
  limits: { joint_name: string; has_position_limits: boolean; min_position: number; max_position: number }[];
}

/** rcl_interfaces/Log. */
export interface Log {
  stamp: Time;
  level: number;
  name: string;
  msg: string;
}

/** moveit_msgs/MoveItErrorCodes. */
export interface ErrorCode {
  val: number;
  message: string;
}

/** moveit_msgs/RobotTrajectory. */
export interface RobotTrajectory {
  joint_trajectory: {
    joint_names: string[];
    points: { positions: number[]; time_from_start: Time }[];
  };
}

/** moveit_msgs/action/MoveGroup's result, and with less in it ExecuteTrajectory's. */
export interface MotionResult {
  error_code: ErrorCode;
  planned_trajectory?: RobotTrajectory;
}

/** armbridge_msgs/GoalCheck. */
export interface GoalCheck {
  code: number;
  message: string;
  reachable: boolean;
  free: boolean;
  decided: boolean;
  position_error_m: number;
  solution: { name: string[]; position: number[] };
}

/** geometry_msgs/Pose. */
export interface Pose {
  position: { x: number; y: number; z: number };
  orientation: { x: number; y: number; z: number; w: number };
}

/** moveit_msgs/CollisionObject. */
export interface CollisionObject {
  header: { frame_id: string };
  id: string;
  pose: Pose;
  primitives: { type: number; dimensions: number[]; polygon?: { points: { x: number; y: number; z: number }[] } }[];
  primitive_poses: Pose[];
  meshes: { triangles: { vertex_indices: number[] }[]; vertices: { x: number; y: number; z: number }[] }[];
  mesh_poses: Pose[];
  planes: { coef: number[] }[];
  plane_poses: Pose[];
  operation: number;
}

/** moveit_msgs/PlanningScene, as far as it is shown. */
export interface PlanningScene {
  is_diff: boolean;
  robot_state: { is_diff: boolean; attached_collision_objects: { link_name: string; object: CollisionObject }[] };
  world: { collision_objects: CollisionObject[] };
  object_colors: { id: string; color: { r: number; g: number; b: number; a: number } }[];
}

/** std_srvs/Trigger's answer. */
export interface Trigger {
  success: boolean;
  message: string;
}

/** control_msgs/action/GripperCommand's result, with the sentence of a goal that was refused. */
export interface GripperResult {
  position: number;
  stalled: boolean;
  reached_goal: boolean;
}

/** control_msgs/JointTrajectoryControllerState. */
export interface ControllerState {
  joint_names: string[];
  reference: { positions: (number | null)[] };
}
