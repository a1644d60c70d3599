// Types of armbridge's messages as rosbridge writes them in JSON, made by generate_types.py: do not edit.
//
// uint8[] is base64 text. NaN and infinite numbers are null. A message that you send may leave fields out.

/** builtin_interfaces/msg/Time */
export interface Time {
  sec: number;
  nanosec: number;
}

/** std_msgs/msg/Header */
export interface Header {
  stamp: Time;
  frame_id: string;
}

/** builtin_interfaces/msg/Duration */
export interface Duration {
  sec: number;
  nanosec: number;
}

/** trajectory_msgs/msg/JointTrajectoryPoint */
export interface JointTrajectoryPoint {
  positions: number[];
  velocities: number[];
  accelerations: number[];
  effort: number[];
  time_from_start: Duration;
}

/** trajectory_msgs/msg/JointTrajectory */
export interface JointTrajectory {
  header: Header;
  joint_names: string[];
  points: JointTrajectoryPoint[];
}

/** armbridge_msgs/msg/ActionChunk */
export interface ActionChunk {
  id: string;
  trajectory: JointTrajectory;
  blend: string;
  weight: number;
}

/** moveit_msgs/msg/MoveItErrorCodes */
export interface MoveItErrorCodes {
  val: number;
  message: string;
  source: string;
}

/** armbridge_msgs/msg/ActionChunkAnswer */
export interface ActionChunkAnswer {
  id: string;
  error_code: MoveItErrorCodes;
  message: string;
  followed_until: Time;
  change: number;
  refused_from: number;
  joint_names: string[];
  nearest: number[];
}

/** armbridge_msgs/msg/TeachState */
export interface TeachState {
  recording: boolean;
  name: string;
  duration_s: number;
  points: number;
  message: string;
}

/** armbridge_msgs/msg/TeleopState */
export interface TeleopState {
  follower: string;
  leader: string;
  phase: string;
  message: string;
  latency_s: number;
  lag_rad: number;
  speed_scale: number;
}

/** control_msgs/msg/JointJog */
export interface JointJog {
  header: Header;
  joint_names: string[];
  displacements: number[];
  velocities: number[];
  duration: number;
}

/** geometry_msgs/msg/Vector3 */
export interface Vector3 {
  x: number;
  y: number;
  z: number;
}

/** geometry_msgs/msg/Quaternion */
export interface Quaternion {
  x: number;
  y: number;
  z: number;
  w: number;
}

/** geometry_msgs/msg/Transform */
export interface Transform {
  translation: Vector3;
  rotation: Quaternion;
}

/** geometry_msgs/msg/Twist */
export interface Twist {
  linear: Vector3;
  angular: Vector3;
}

/** trajectory_msgs/msg/MultiDOFJointTrajectoryPoint */
export interface MultiDOFJointTrajectoryPoint {
  transforms: Transform[];
  velocities: Twist[];
  accelerations: Twist[];
  time_from_start: Duration;
}

/** control_msgs/msg/JointTrajectoryControllerState */
export interface JointTrajectoryControllerState {
  header: Header;
  joint_names: string[];
  reference: JointTrajectoryPoint;
  feedback: JointTrajectoryPoint;
  error: JointTrajectoryPoint;
  output: JointTrajectoryPoint;
  multi_dof_joint_names: string[];
  multi_dof_reference: MultiDOFJointTrajectoryPoint;
  multi_dof_feedback: MultiDOFJointTrajectoryPoint;
  multi_dof_error: MultiDOFJointTrajectoryPoint;
  multi_dof_output: MultiDOFJointTrajectoryPoint;
  speed_scaling_factor: number;
}

/** diagnostic_msgs/msg/KeyValue */
export interface KeyValue {
  key: string;
  value: string;
}

/** diagnostic_msgs/msg/DiagnosticStatus */
export interface DiagnosticStatus {
  level: number;
  name: string;
  message: string;
  hardware_id: string;
  values: KeyValue[];
}

/** geometry_msgs/msg/TwistStamped */
export interface TwistStamped {
  header: Header;
  twist: Twist;
}

/** moveit_msgs/msg/JointLimits */
export interface JointLimits {
  joint_name: string;
  has_position_limits: boolean;
  min_position: number;
  max_position: number;
  has_velocity_limits: boolean;
  max_velocity: number;
  has_acceleration_limits: boolean;
  max_acceleration: number;
  has_jerk_limits: boolean;
  max_jerk: number;
}

/** moveit_msgs/msg/KinematicSolverInfo */
export interface KinematicSolverInfo {
  joint_names: string[];
  limits: JointLimits[];
  link_names: string[];
}

/** sensor_msgs/msg/JointState */
export interface JointState {
  header: Header;
  name: string[];
  position: number[];
  velocity: number[];
  effort: number[];
}

/** geometry_msgs/msg/Wrench */
export interface Wrench {
  force: Vector3;
  torque: Vector3;
}

/** sensor_msgs/msg/MultiDOFJointState */
export interface MultiDOFJointState {
  header: Header;
  joint_names: string[];
  transforms: Transform[];
  twist: Twist[];
  wrench: Wrench[];
}

/** geometry_msgs/msg/Point */
export interface Point {
  x: number;
  y: number;
  z: number;
}

/** geometry_msgs/msg/Pose */
export interface Pose {
  position: Point;
  orientation: Quaternion;
}

/** object_recognition_msgs/msg/ObjectType */
export interface ObjectType {
  key: string;
  db: string;
}

/** geometry_msgs/msg/Point32 */
export interface Point32 {
  x: number;
  y: number;
  z: number;
}

/** geometry_msgs/msg/Polygon */
export interface Polygon {
  points: Point32[];
}

/** shape_msgs/msg/SolidPrimitive */
export interface SolidPrimitive {
  type: number;
  dimensions: number[];
  polygon: Polygon;
}

/** shape_msgs/msg/MeshTriangle */
export interface MeshTriangle {
  vertex_indices: number[];
}

/** shape_msgs/msg/Mesh */
export interface Mesh {
  triangles: MeshTriangle[];
  vertices: Point[];
}

/** shape_msgs/msg/Plane */
export interface Plane {
  coef: number[];
}

/** moveit_msgs/msg/CollisionObject */
export interface CollisionObject {
  header: Header;
  pose: Pose;
  id: string;
  type: ObjectType;
  primitives: SolidPrimitive[];
  primitive_poses: Pose[];
  meshes: Mesh[];
  mesh_poses: Pose[];
  planes: Plane[];
  plane_poses: Pose[];
  subframe_names: string[];
  subframe_poses: Pose[];
  operation: number;
}

/** moveit_msgs/msg/AttachedCollisionObject */
export interface AttachedCollisionObject {
  link_name: string;
  object: CollisionObject;
  touch_links: string[];
  detach_posture: JointTrajectory;
  weight: number;
}

/** moveit_msgs/msg/RobotState */
export interface RobotState {
  joint_state: JointState;
  multi_dof_joint_state: MultiDOFJointState;
  attached_collision_objects: AttachedCollisionObject[];
  is_diff: boolean;
}

/** geometry_msgs/msg/TransformStamped */
export interface TransformStamped {
  header: Header;
  child_frame_id: string;
  transform: Transform;
}

/** moveit_msgs/msg/AllowedCollisionEntry */
export interface AllowedCollisionEntry {
  enabled: boolean[];
}

/** moveit_msgs/msg/AllowedCollisionMatrix */
export interface AllowedCollisionMatrix {
  entry_names: string[];
  entry_values: AllowedCollisionEntry[];
  default_entry_names: string[];
  default_entry_values: boolean[];
}

/** moveit_msgs/msg/LinkPadding */
export interface LinkPadding {
  link_name: string;
  padding: number;
}

/** moveit_msgs/msg/LinkScale */
export interface LinkScale {
  link_name: string;
  scale: number;
}

/** std_msgs/msg/ColorRGBA */
export interface ColorRGBA {
  r: number;
  g: number;
  b: number;
  a: number;
}

/** moveit_msgs/msg/ObjectColor */
export interface ObjectColor {
  id: string;
  color: ColorRGBA;
}

/** octomap_msgs/msg/Octomap */
export interface Octomap {
  header: Header;
  binary: boolean;
  id: string;
  resolution: number;
  data: number[];
}

/** octomap_msgs/msg/OctomapWithPose */
export interface OctomapWithPose {
  header: Header;
  origin: Pose;
  octomap: Octomap;
}

/** moveit_msgs/msg/PlanningSceneWorld */
export interface PlanningSceneWorld {
  collision_objects: CollisionObject[];
  octomap: OctomapWithPose;
}

/** moveit_msgs/msg/PlanningScene */
export interface PlanningScene {
  name: string;
  robot_state: RobotState;
  robot_model_name: string;
  fixed_frame_transforms: TransformStamped[];
  allowed_collision_matrix: AllowedCollisionMatrix;
  link_padding: LinkPadding[];
  link_scale: LinkScale[];
  object_colors: ObjectColor[];
  world: PlanningSceneWorld;
  is_diff: boolean;
}

/** moveit_msgs/msg/ServoStatus */
export interface ServoStatus {
  code: number;
  message: string;
}

/** sensor_msgs/msg/CompressedImage */
export interface CompressedImage {
  header: Header;
  format: string;
  data: string;
}

/** std_msgs/msg/Bool */
export interface Bool {
  data: boolean;
}

/** std_msgs/msg/Empty */
export interface Empty {
}

/** std_msgs/msg/Float64 */
export interface Float64 {
  data: number;
}

/** std_msgs/msg/String */
export interface String {
  data: string;
}

/** armbridge_msgs/srv/BeginTeaching_Request */
export interface BeginTeachingRequest {
  name: string;
  group: string;
}

/** armbridge_msgs/srv/BeginTeaching_Response */
export interface BeginTeachingResponse {
  success: boolean;
  message: string;
}

/** geometry_msgs/msg/PoseStamped */
export interface PoseStamped {
  header: Header;
  pose: Pose;
}

/** armbridge_msgs/srv/CheckGoals_Request */
export interface CheckGoalsRequest {
  poses: PoseStamped[];
  joints: JointState[];
}

/** armbridge_msgs/msg/GoalCheck */
export interface GoalCheck {
  code: number;
  message: string;
  reachable: boolean;
  free: boolean;
  decided: boolean;
  position_error_m: number;
  orientation_error_rad: number;
  duration_s: number;
  solution: JointState;
}

/** armbridge_msgs/srv/CheckGoals_Response */
export interface CheckGoalsResponse {
  results: GoalCheck[];
}

/** armbridge_msgs/srv/CheckMotion_Request */
export interface CheckMotionRequest {
  name: string;
  speed: number;
}

/** armbridge_msgs/srv/CheckMotion_Response */
export interface CheckMotionResponse {
  success: boolean;
  message: string;
  duration_s: number;
}

/** armbridge_msgs/srv/DeleteMotion_Request */
export interface DeleteMotionRequest {
  name: string;
}

/** armbridge_msgs/srv/DeleteMotion_Response */
export interface DeleteMotionResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/DeleteScene_Request */
export interface DeleteSceneRequest {
  name: string;
}

/** armbridge_msgs/srv/DeleteScene_Response */
export interface DeleteSceneResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/EndTeaching_Request */
export interface EndTeachingRequest {
}

/** armbridge_msgs/srv/EndTeaching_Response */
export interface EndTeachingResponse {
  success: boolean;
  message: string;
  duration_s: number;
  points: number;
}

/** armbridge_msgs/srv/ListMotions_Request */
export interface ListMotionsRequest {
}

/** armbridge_msgs/srv/ListMotions_Response */
export interface ListMotionsResponse {
  names: string[];
}

/** armbridge_msgs/srv/ListScenes_Request */
export interface ListScenesRequest {
}

/** armbridge_msgs/srv/ListScenes_Response */
export interface ListScenesResponse {
  names: string[];
}

/** armbridge_msgs/srv/LoadScene_Request */
export interface LoadSceneRequest {
  name: string;
}

/** armbridge_msgs/srv/LoadScene_Response */
export interface LoadSceneResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/MoveitGoal_Request */
export interface MoveitGoalRequest {
  named: string;
  joints: JointState;
  pose: PoseStamped;
  group: string;
  velocity_scaling: number;
  acceleration_scaling: number;
  plan_only: boolean;
  optimization: string;
  optimization_time: number;
  allowed_planning_time: number;
}

/** armbridge_msgs/msg/GoalTarget */
export interface GoalTarget {
  named: string;
  joints: JointState;
  pose: PoseStamped;
}

/** armbridge_msgs/srv/MoveitGoal_Response */
export interface MoveitGoalResponse {
  success: boolean;
  code: number;
  code_name: string;
  message: string;
  goal_id: string;
  duration_s: number;
  suggested: GoalTarget;
  details: KeyValue[];
}

/** armbridge_msgs/srv/RenameMotion_Request */
export interface RenameMotionRequest {
  name: string;
  new_name: string;
}

/** armbridge_msgs/srv/RenameMotion_Response */
export interface RenameMotionResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/SaveScene_Request */
export interface SaveSceneRequest {
  name: string;
}

/** armbridge_msgs/srv/SaveScene_Response */
export interface SaveSceneResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/SetBody_Request */
export interface SetBodyRequest {
  id: string;
  movable: boolean;
  mass: number;
  friction: number;
}

/** armbridge_msgs/srv/SetBody_Response */
export interface SetBodyResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/SetBodyPose_Request */
export interface SetBodyPoseRequest {
  id: string;
  pose: Pose;
}

/** armbridge_msgs/srv/SetBodyPose_Response */
export interface SetBodyPoseResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/SetSpeedLimit_Request */
export interface SetSpeedLimitRequest {
  speed_limit: number;
}

/** armbridge_msgs/srv/SetSpeedLimit_Response */
export interface SetSpeedLimitResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/StartEpisode_Request */
export interface StartEpisodeRequest {
  task: string;
}

/** armbridge_msgs/srv/StartEpisode_Response */
export interface StartEpisodeResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/StartTeleop_Request */
export interface StartTeleopRequest {
  follower: string;
  leader: string;
  scale: number;
  mirror: boolean;
  leader_joints: string[];
  follower_joints: string[];
}

/** armbridge_msgs/srv/StartTeleop_Response */
export interface StartTeleopResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/StepSimulation_Request */
export interface StepSimulationRequest {
  steps: number;
}

/** armbridge_msgs/srv/StepSimulation_Response */
export interface StepSimulationResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/srv/TrimMotion_Request */
export interface TrimMotionRequest {
  name: string;
  from_s: number;
  to_s: number;
}

/** armbridge_msgs/srv/TrimMotion_Response */
export interface TrimMotionResponse {
  success: boolean;
  message: string;
  duration_s: number;
}

/** moveit_msgs/srv/ApplyPlanningScene_Request */
export interface ApplyPlanningSceneRequest {
  scene: PlanningScene;
}

/** moveit_msgs/srv/ApplyPlanningScene_Response */
export interface ApplyPlanningSceneResponse {
  success: boolean;
}

/** moveit_msgs/srv/DeleteRobotStateFromWarehouse_Request */
export interface DeleteRobotStateFromWarehouseRequest {
  name: string;
  robot: string;
}

/** moveit_msgs/srv/DeleteRobotStateFromWarehouse_Response */
export interface DeleteRobotStateFromWarehouseResponse {
}

/** moveit_msgs/msg/JointConstraint */
export interface JointConstraint {
  joint_name: string;
  position: number;
  tolerance_above: number;
  tolerance_below: number;
  weight: number;
}

/** moveit_msgs/msg/BoundingVolume */
export interface BoundingVolume {
  primitives: SolidPrimitive[];
  primitive_poses: Pose[];
  meshes: Mesh[];
  mesh_poses: Pose[];
}

/** moveit_msgs/msg/PositionConstraint */
export interface PositionConstraint {
  header: Header;
  link_name: string;
  target_point_offset: Vector3;
  constraint_region: BoundingVolume;
  weight: number;
}

/** moveit_msgs/msg/OrientationConstraint */
export interface OrientationConstraint {
  header: Header;
  orientation: Quaternion;
  link_name: string;
  absolute_x_axis_tolerance: number;
  absolute_y_axis_tolerance: number;
  absolute_z_axis_tolerance: number;
  parameterization: number;
  weight: number;
}

/** moveit_msgs/msg/VisibilityConstraint */
export interface VisibilityConstraint {
  target_radius: number;
  target_pose: PoseStamped;
  cone_sides: number;
  sensor_pose: PoseStamped;
  max_view_angle: number;
  max_range_angle: number;
  sensor_view_direction: number;
  weight: number;
}

/** moveit_msgs/msg/Constraints */
export interface Constraints {
  name: string;
  joint_constraints: JointConstraint[];
  position_constraints: PositionConstraint[];
  orientation_constraints: OrientationConstraint[];
  visibility_constraints: VisibilityConstraint[];
}

/** moveit_msgs/srv/GetCartesianPath_Request */
export interface GetCartesianPathRequest {
  header: Header;
  start_state: RobotState;
  group_name: string;
  link_name: string;
  waypoints: Pose[];
  max_step: number;
  jump_threshold: number;
  prismatic_jump_threshold: number;
  revolute_jump_threshold: number;
  avoid_collisions: boolean;
  path_constraints: Constraints;
  max_velocity_scaling_factor: number;
  max_acceleration_scaling_factor: number;
  cartesian_speed_limited_link: string;
  max_cartesian_speed: number;
}

/** trajectory_msgs/msg/MultiDOFJointTrajectory */
export interface MultiDOFJointTrajectory {
  header: Header;
  joint_names: string[];
  points: MultiDOFJointTrajectoryPoint[];
}

/** moveit_msgs/msg/RobotTrajectory */
export interface RobotTrajectory {
  joint_trajectory: JointTrajectory;
  multi_dof_joint_trajectory: MultiDOFJointTrajectory;
}

/** moveit_msgs/srv/GetCartesianPath_Response */
export interface GetCartesianPathResponse {
  start_state: RobotState;
  solution: RobotTrajectory;
  fraction: number;
  error_code: MoveItErrorCodes;
}

/** moveit_msgs/msg/WorkspaceParameters */
export interface WorkspaceParameters {
  header: Header;
  min_corner: Vector3;
  max_corner: Vector3;
}

/** moveit_msgs/msg/TrajectoryConstraints */
export interface TrajectoryConstraints {
  constraints: Constraints[];
}

/** geometry_msgs/msg/Accel */
export interface Accel {
  linear: Vector3;
  angular: Vector3;
}

/** moveit_msgs/msg/CartesianPoint */
export interface CartesianPoint {
  pose: Pose;
  velocity: Twist;
  acceleration: Accel;
}

/** moveit_msgs/msg/CartesianTrajectoryPoint */
export interface CartesianTrajectoryPoint {
  point: CartesianPoint;
  time_from_start: Duration;
}

/** moveit_msgs/msg/CartesianTrajectory */
export interface CartesianTrajectory {
  header: Header;
  tracked_frame: string;
  points: CartesianTrajectoryPoint[];
}

/** moveit_msgs/msg/GenericTrajectory */
export interface GenericTrajectory {
  header: Header;
  joint_trajectory: JointTrajectory[];
  cartesian_trajectory: CartesianTrajectory[];
}

/** moveit_msgs/msg/MotionPlanRequest */
export interface MotionPlanRequest {
  workspace_parameters: WorkspaceParameters;
  start_state: RobotState;
  goal_constraints: Constraints[];
  path_constraints: Constraints;
  trajectory_constraints: TrajectoryConstraints;
  reference_trajectories: GenericTrajectory[];
  pipeline_id: string;
  planner_id: string;
  group_name: string;
  num_planning_attempts: number;
  allowed_planning_time: number;
  max_velocity_scaling_factor: number;
  max_acceleration_scaling_factor: number;
  cartesian_speed_limited_link: string;
  max_cartesian_speed: number;
}

/** moveit_msgs/srv/GetMotionPlan_Request */
export interface GetMotionPlanRequest {
  motion_plan_request: MotionPlanRequest;
}

/** moveit_msgs/msg/MotionPlanResponse */
export interface MotionPlanResponse {
  trajectory_start: RobotState;
  group_name: string;
  trajectory: RobotTrajectory;
  planning_time: number;
  error_code: MoveItErrorCodes;
}

/** moveit_msgs/srv/GetMotionPlan_Response */
export interface GetMotionPlanResponse {
  motion_plan_response: MotionPlanResponse;
}

/** moveit_msgs/msg/PlanningSceneComponents */
export interface PlanningSceneComponents {
  components: number;
}

/** moveit_msgs/srv/GetPlanningScene_Request */
export interface GetPlanningSceneRequest {
  components: PlanningSceneComponents;
}

/** moveit_msgs/srv/GetPlanningScene_Response */
export interface GetPlanningSceneResponse {
  scene: PlanningScene;
}

/** moveit_msgs/srv/GetPositionFK_Request */
export interface GetPositionFKRequest {
  header: Header;
  fk_link_names: string[];
  robot_state: RobotState;
}

/** moveit_msgs/srv/GetPositionFK_Response */
export interface GetPositionFKResponse {
  pose_stamped: PoseStamped[];
  fk_link_names: string[];
  error_code: MoveItErrorCodes;
}

/** moveit_msgs/srv/SaveRobotStateToWarehouse_Request */
export interface SaveRobotStateToWarehouseRequest {
  name: string;
  robot: string;
  state: RobotState;
}

/** moveit_msgs/srv/SaveRobotStateToWarehouse_Response */
export interface SaveRobotStateToWarehouseResponse {
  success: boolean;
}

/** rosapi_msgs/srv/TopicsForType_Request */
export interface TopicsForTypeRequest {
  type: string;
}

/** rosapi_msgs/srv/TopicsForType_Response */
export interface TopicsForTypeResponse {
  topics: string[];
}

/** std_srvs/srv/SetBool_Request */
export interface SetBoolRequest {
  data: boolean;
}

/** std_srvs/srv/SetBool_Response */
export interface SetBoolResponse {
  success: boolean;
  message: string;
}

/** std_srvs/srv/Trigger_Request */
export interface TriggerRequest {
}

/** std_srvs/srv/Trigger_Response */
export interface TriggerResponse {
  success: boolean;
  message: string;
}

/** armbridge_msgs/action/MoveitGoal_Goal */
export interface MoveitGoalGoal {
  named: string;
  joints: JointState;
  pose: PoseStamped;
  group: string;
  velocity_scaling: number;
  acceleration_scaling: number;
  plan_only: boolean;
  optimization: string;
  optimization_time: number;
  allowed_planning_time: number;
}

/** armbridge_msgs/action/MoveitGoal_Result */
export interface MoveitGoalResult {
  success: boolean;
  code: number;
  code_name: string;
  message: string;
  goal_id: string;
  duration_s: number;
  suggested: GoalTarget;
  details: KeyValue[];
}

/** armbridge_msgs/action/MoveitGoal_Feedback */
export interface MoveitGoalFeedback {
  state: string;
  message: string;
  fraction: number;
  seconds_left: number;
}

/** armbridge_msgs/action/ReplayMotion_Goal */
export interface ReplayMotionGoal {
  name: string;
  speed: number;
  reverse: boolean;
  repeat: number;
}

/** armbridge_msgs/action/ReplayMotion_Result */
export interface ReplayMotionResult {
  error_code: MoveItErrorCodes;
  message: string;
}

/** armbridge_msgs/action/ReplayMotion_Feedback */
export interface ReplayMotionFeedback {
  state: string;
  fraction: number;
  remaining_s: number;
}

/** control_msgs/msg/GripperCommand */
export interface GripperCommand {
  position: number;
  max_effort: number;
}

/** control_msgs/action/GripperCommand_Goal */
export interface GripperCommandGoal {
  command: GripperCommand;
}

/** control_msgs/action/GripperCommand_Result */
export interface GripperCommandResult {
  position: number;
  effort: number;
  stalled: boolean;
  reached_goal: boolean;
}

/** control_msgs/action/GripperCommand_Feedback */
export interface GripperCommandFeedback {
  position: number;
  effort: number;
  stalled: boolean;
  reached_goal: boolean;
}

/** moveit_msgs/action/ExecuteTrajectory_Goal */
export interface ExecuteTrajectoryGoal {
  trajectory: RobotTrajectory;
  controller_names: string[];
}

/** moveit_msgs/action/ExecuteTrajectory_Result */
export interface ExecuteTrajectoryResult {
  error_code: MoveItErrorCodes;
}

/** moveit_msgs/action/ExecuteTrajectory_Feedback */
export interface ExecuteTrajectoryFeedback {
  state: string;
}

export interface Messages {
  "armbridge_msgs/msg/ActionChunk": ActionChunk;
  "armbridge_msgs/msg/ActionChunkAnswer": ActionChunkAnswer;
  "armbridge_msgs/msg/TeachState": TeachState;
  "armbridge_msgs/msg/TeleopState": TeleopState;
  "control_msgs/msg/JointJog": JointJog;
  "control_msgs/msg/JointTrajectoryControllerState": JointTrajectoryControllerState;
  "diagnostic_msgs/msg/DiagnosticStatus": DiagnosticStatus;
  "geometry_msgs/msg/TwistStamped": TwistStamped;
  "moveit_msgs/msg/KinematicSolverInfo": KinematicSolverInfo;
  "moveit_msgs/msg/MoveItErrorCodes": MoveItErrorCodes;
  "moveit_msgs/msg/PlanningScene": PlanningScene;
  "moveit_msgs/msg/ServoStatus": ServoStatus;
  "sensor_msgs/msg/CompressedImage": CompressedImage;
  "sensor_msgs/msg/JointState": JointState;
  "std_msgs/msg/Bool": Bool;
  "std_msgs/msg/Empty": Empty;
  "std_msgs/msg/Float64": Float64;
  "std_msgs/msg/String": String;
}

export interface Services {
  "armbridge_msgs/srv/BeginTeaching": { request: BeginTeachingRequest; response: BeginTeachingResponse };
  "armbridge_msgs/srv/CheckGoals": { request: CheckGoalsRequest; response: CheckGoalsResponse };
  "armbridge_msgs/srv/CheckMotion": { request: CheckMotionRequest; response: CheckMotionResponse };
  "armbridge_msgs/srv/DeleteMotion": { request: DeleteMotionRequest; response: DeleteMotionResponse };
  "armbridge_msgs/srv/DeleteScene": { request: DeleteSceneRequest; response: DeleteSceneResponse };
  "armbridge_msgs/srv/EndTeaching": { request: EndTeachingRequest; response: EndTeachingResponse };
  "armbridge_msgs/srv/ListMotions": { request: ListMotionsRequest; response: ListMotionsResponse };
  "armbridge_msgs/srv/ListScenes": { request: ListScenesRequest; response: ListScenesResponse };
  "armbridge_msgs/srv/LoadScene": { request: LoadSceneRequest; response: LoadSceneResponse };
  "armbridge_msgs/srv/MoveitGoal": { request: MoveitGoalRequest; response: MoveitGoalResponse };
  "armbridge_msgs/srv/RenameMotion": { request: RenameMotionRequest; response: RenameMotionResponse };
  "armbridge_msgs/srv/SaveScene": { request: SaveSceneRequest; response: SaveSceneResponse };
  "armbridge_msgs/srv/SetBody": { request: SetBodyRequest; response: SetBodyResponse };
  "armbridge_msgs/srv/SetBodyPose": { request: SetBodyPoseRequest; response: SetBodyPoseResponse };
  "armbridge_msgs/srv/SetSpeedLimit": { request: SetSpeedLimitRequest; response: SetSpeedLimitResponse };
  "armbridge_msgs/srv/StartEpisode": { request: StartEpisodeRequest; response: StartEpisodeResponse };
  "armbridge_msgs/srv/StartTeleop": { request: StartTeleopRequest; response: StartTeleopResponse };
  "armbridge_msgs/srv/StepSimulation": { request: StepSimulationRequest; response: StepSimulationResponse };
  "armbridge_msgs/srv/TrimMotion": { request: TrimMotionRequest; response: TrimMotionResponse };
  "moveit_msgs/srv/ApplyPlanningScene": { request: ApplyPlanningSceneRequest; response: ApplyPlanningSceneResponse };
  "moveit_msgs/srv/DeleteRobotStateFromWarehouse": { request: DeleteRobotStateFromWarehouseRequest; response: DeleteRobotStateFromWarehouseResponse };
  "moveit_msgs/srv/GetCartesianPath": { request: GetCartesianPathRequest; response: GetCartesianPathResponse };
  "moveit_msgs/srv/GetMotionPlan": { request: GetMotionPlanRequest; response: GetMotionPlanResponse };
  "moveit_msgs/srv/GetPlanningScene": { request: GetPlanningSceneRequest; response: GetPlanningSceneResponse };
  "moveit_msgs/srv/GetPositionFK": { request: GetPositionFKRequest; response: GetPositionFKResponse };
  "moveit_msgs/srv/SaveRobotStateToWarehouse": { request: SaveRobotStateToWarehouseRequest; response: SaveRobotStateToWarehouseResponse };
  "rosapi_msgs/srv/TopicsForType": { request: TopicsForTypeRequest; response: TopicsForTypeResponse };
  "std_srvs/srv/SetBool": { request: SetBoolRequest; response: SetBoolResponse };
  "std_srvs/srv/Trigger": { request: TriggerRequest; response: TriggerResponse };
}

export interface Actions {
  "armbridge_msgs/action/MoveitGoal": { goal: MoveitGoalGoal; result: MoveitGoalResult; feedback: MoveitGoalFeedback };
  "armbridge_msgs/action/ReplayMotion": { goal: ReplayMotionGoal; result: ReplayMotionResult; feedback: ReplayMotionFeedback };
  "control_msgs/action/GripperCommand": { goal: GripperCommandGoal; result: GripperCommandResult; feedback: GripperCommandFeedback };
  "moveit_msgs/action/ExecuteTrajectory": { goal: ExecuteTrajectoryGoal; result: ExecuteTrajectoryResult; feedback: ExecuteTrajectoryFeedback };
}
