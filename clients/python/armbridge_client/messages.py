"""Message types as dataclasses, made by generate_messages.py from the server's type tables: do not edit.

Names of services and actions have the endings Request, Response, Goal, Result and Feedback.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

from armbridge_client.wire import Action, Message, Service


@dataclass(repr=False)
class Time(Message):
    """builtin_interfaces/msg/Time."""

    TYPE: ClassVar[str] = "builtin_interfaces/msg/Time"
    sec: int = 0
    nanosec: int = 0


@dataclass(repr=False)
class Header(Message):
    """std_msgs/msg/Header."""

    TYPE: ClassVar[str] = "std_msgs/msg/Header"
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass(repr=False)
class Duration(Message):
    """builtin_interfaces/msg/Duration."""

    TYPE: ClassVar[str] = "builtin_interfaces/msg/Duration"
    sec: int = 0
    nanosec: int = 0


@dataclass(repr=False)
class JointTrajectoryPoint(Message):
    """trajectory_msgs/msg/JointTrajectoryPoint."""

    TYPE: ClassVar[str] = "trajectory_msgs/msg/JointTrajectoryPoint"
    positions: list[float] = field(default_factory=list[float])
    velocities: list[float] = field(default_factory=list[float])
    accelerations: list[float] = field(default_factory=list[float])
    effort: list[float] = field(default_factory=list[float])
    time_from_start: Duration = field(default_factory=Duration)


@dataclass(repr=False)
class JointTrajectory(Message):
    """trajectory_msgs/msg/JointTrajectory."""

    TYPE: ClassVar[str] = "trajectory_msgs/msg/JointTrajectory"
    header: Header = field(default_factory=Header)
    joint_names: list[str] = field(default_factory=list[str])
    points: list[JointTrajectoryPoint] = field(default_factory=list[JointTrajectoryPoint])


@dataclass(repr=False)
class ActionChunk(Message):
    """armbridge_msgs/msg/ActionChunk."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/ActionChunk"
    id: str = ""
    trajectory: JointTrajectory = field(default_factory=JointTrajectory)
    blend: str = ""
    weight: float = 0.0


@dataclass(repr=False)
class MoveItErrorCodes(Message):
    """moveit_msgs/msg/MoveItErrorCodes."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/MoveItErrorCodes"
    val: int = 0
    message: str = ""
    source: str = ""


class MoveItErrorCode(IntEnum):
    """Values of moveit_msgs/MoveItErrorCodes."""

    SUCCESS = 1
    UNDEFINED = 0
    FAILURE = 99999
    PLANNING_FAILED = -1
    INVALID_MOTION_PLAN = -2
    MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE = -3
    CONTROL_FAILED = -4
    UNABLE_TO_AQUIRE_SENSOR_DATA = -5
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    START_STATE_INVALID = -26
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    GOAL_STATE_INVALID = -27
    UNRECOGNIZED_GOAL_TYPE = -28
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    FRAME_TRANSFORM_FAILURE = -21
    COLLISION_CHECKING_UNAVAILABLE = -22
    ROBOT_STATE_STALE = -23
    SENSOR_INFO_STALE = -24
    COMMUNICATION_FAILURE = -25
    CRASH = -29
    ABORT = -30
    NO_IK_SOLUTION = -31


@dataclass(repr=False)
class ActionChunkAnswer(Message):
    """armbridge_msgs/msg/ActionChunkAnswer."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/ActionChunkAnswer"
    id: str = ""
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)
    message: str = ""
    followed_until: Time = field(default_factory=Time)
    change: float = 0.0
    refused_from: int = 0
    joint_names: list[str] = field(default_factory=list[str])
    nearest: list[float] = field(default_factory=list[float])


@dataclass(repr=False)
class TeachState(Message):
    """armbridge_msgs/msg/TeachState."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/TeachState"
    recording: bool = False
    name: str = ""
    duration_s: float = 0.0
    points: int = 0
    message: str = ""


@dataclass(repr=False)
class TeleopState(Message):
    """armbridge_msgs/msg/TeleopState."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/TeleopState"
    follower: str = ""
    leader: str = ""
    phase: str = ""
    message: str = ""
    latency_s: float = 0.0
    lag_rad: float = 0.0
    speed_scale: float = 0.0


@dataclass(repr=False)
class JointJog(Message):
    """control_msgs/msg/JointJog."""

    TYPE: ClassVar[str] = "control_msgs/msg/JointJog"
    header: Header = field(default_factory=Header)
    joint_names: list[str] = field(default_factory=list[str])
    displacements: list[float] = field(default_factory=list[float])
    velocities: list[float] = field(default_factory=list[float])
    duration: float = 0.0


@dataclass(repr=False)
class JointTrajectoryControllerState(Message):
    """control_msgs/msg/JointTrajectoryControllerState."""

    TYPE: ClassVar[str] = "control_msgs/msg/JointTrajectoryControllerState"
    joint_names: list[str] = field(default_factory=list[str])
    reference: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)


@dataclass(repr=False)
class KeyValue(Message):
    """diagnostic_msgs/msg/KeyValue."""

    TYPE: ClassVar[str] = "diagnostic_msgs/msg/KeyValue"
    key: str = ""
    value: str = ""


@dataclass(repr=False)
class DiagnosticStatus(Message):
    """diagnostic_msgs/msg/DiagnosticStatus."""

    TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticStatus"
    level: int = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: list[KeyValue] = field(default_factory=list[KeyValue])


@dataclass(repr=False)
class Vector3(Message):
    """geometry_msgs/msg/Vector3."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/Vector3"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(repr=False)
class Twist(Message):
    """geometry_msgs/msg/Twist."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/Twist"
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass(repr=False)
class TwistStamped(Message):
    """geometry_msgs/msg/TwistStamped."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass(repr=False)
class JointLimits(Message):
    """moveit_msgs/msg/JointLimits."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/JointLimits"
    joint_name: str = ""
    has_position_limits: bool = False
    min_position: float = 0.0
    max_position: float = 0.0
    has_velocity_limits: bool = False
    max_velocity: float = 0.0
    has_acceleration_limits: bool = False
    max_acceleration: float = 0.0
    has_jerk_limits: bool = False
    max_jerk: float = 0.0


@dataclass(repr=False)
class KinematicSolverInfo(Message):
    """moveit_msgs/msg/KinematicSolverInfo."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/KinematicSolverInfo"
    joint_names: list[str] = field(default_factory=list[str])
    limits: list[JointLimits] = field(default_factory=list[JointLimits])
    link_names: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class JointState(Message):
    """sensor_msgs/msg/JointState."""

    TYPE: ClassVar[str] = "sensor_msgs/msg/JointState"
    header: Header = field(default_factory=Header)
    name: list[str] = field(default_factory=list[str])
    position: list[float] = field(default_factory=list[float])
    velocity: list[float] = field(default_factory=list[float])
    effort: list[float] = field(default_factory=list[float])


@dataclass(repr=False)
class Point(Message):
    """geometry_msgs/msg/Point."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/Point"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(repr=False)
class Quaternion(Message):
    """geometry_msgs/msg/Quaternion."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/Quaternion"
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


@dataclass(repr=False)
class Pose(Message):
    """geometry_msgs/msg/Pose."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/Pose"
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass(repr=False)
class SolidPrimitive(Message):
    """shape_msgs/msg/SolidPrimitive."""

    TYPE: ClassVar[str] = "shape_msgs/msg/SolidPrimitive"
    type: int = 0
    dimensions: list[float] = field(default_factory=list[float])


@dataclass(repr=False)
class MeshTriangle(Message):
    """shape_msgs/msg/MeshTriangle."""

    TYPE: ClassVar[str] = "shape_msgs/msg/MeshTriangle"
    vertex_indices: list[int] = field(default_factory=list[int])


@dataclass(repr=False)
class Mesh(Message):
    """shape_msgs/msg/Mesh."""

    TYPE: ClassVar[str] = "shape_msgs/msg/Mesh"
    triangles: list[MeshTriangle] = field(default_factory=list[MeshTriangle])
    vertices: list[Point] = field(default_factory=list[Point])


@dataclass(repr=False)
class CollisionObject(Message):
    """moveit_msgs/msg/CollisionObject."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/CollisionObject"
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)
    id: str = ""
    primitives: list[SolidPrimitive] = field(default_factory=list[SolidPrimitive])
    primitive_poses: list[Pose] = field(default_factory=list[Pose])
    meshes: list[Mesh] = field(default_factory=list[Mesh])
    mesh_poses: list[Pose] = field(default_factory=list[Pose])
    operation: int = 0


@dataclass(repr=False)
class AttachedCollisionObject(Message):
    """moveit_msgs/msg/AttachedCollisionObject."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/AttachedCollisionObject"
    link_name: str = ""
    object: CollisionObject = field(default_factory=CollisionObject)
    touch_links: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class RobotState(Message):
    """moveit_msgs/msg/RobotState."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/RobotState"
    joint_state: JointState = field(default_factory=JointState)
    attached_collision_objects: list[AttachedCollisionObject] = field(default_factory=list[AttachedCollisionObject])
    is_diff: bool = False


@dataclass(repr=False)
class AllowedCollisionEntry(Message):
    """moveit_msgs/msg/AllowedCollisionEntry."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/AllowedCollisionEntry"
    enabled: list[bool] = field(default_factory=list[bool])


@dataclass(repr=False)
class AllowedCollisionMatrix(Message):
    """moveit_msgs/msg/AllowedCollisionMatrix."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/AllowedCollisionMatrix"
    entry_names: list[str] = field(default_factory=list[str])
    entry_values: list[AllowedCollisionEntry] = field(default_factory=list[AllowedCollisionEntry])
    default_entry_names: list[str] = field(default_factory=list[str])
    default_entry_values: list[bool] = field(default_factory=list[bool])


@dataclass(repr=False)
class PlanningSceneWorld(Message):
    """moveit_msgs/msg/PlanningSceneWorld."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/PlanningSceneWorld"
    collision_objects: list[CollisionObject] = field(default_factory=list[CollisionObject])


@dataclass(repr=False)
class PlanningScene(Message):
    """moveit_msgs/msg/PlanningScene."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/PlanningScene"
    robot_state: RobotState = field(default_factory=RobotState)
    allowed_collision_matrix: AllowedCollisionMatrix = field(default_factory=AllowedCollisionMatrix)
    world: PlanningSceneWorld = field(default_factory=PlanningSceneWorld)
    is_diff: bool = False


@dataclass(repr=False)
class ServoStatus(Message):
    """moveit_msgs/msg/ServoStatus."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/ServoStatus"
    code: int = 0
    message: str = ""


@dataclass(repr=False)
class CompressedImage(Message):
    """sensor_msgs/msg/CompressedImage."""

    TYPE: ClassVar[str] = "sensor_msgs/msg/CompressedImage"
    header: Header = field(default_factory=Header)
    format: str = ""
    data: bytes = b""


@dataclass(repr=False)
class Bool(Message):
    """std_msgs/msg/Bool."""

    TYPE: ClassVar[str] = "std_msgs/msg/Bool"
    data: bool = False


@dataclass(repr=False)
class Empty(Message):
    """std_msgs/msg/Empty."""

    TYPE: ClassVar[str] = "std_msgs/msg/Empty"


@dataclass(repr=False)
class Float64(Message):
    """std_msgs/msg/Float64."""

    TYPE: ClassVar[str] = "std_msgs/msg/Float64"
    data: float = 0.0


@dataclass(repr=False)
class String(Message):
    """std_msgs/msg/String."""

    TYPE: ClassVar[str] = "std_msgs/msg/String"
    data: str = ""


@dataclass(repr=False)
class BeginTeachingResponse(Message):
    """armbridge_msgs/srv/BeginTeaching_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/BeginTeaching_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class BeginTeachingRequest(Service[BeginTeachingResponse]):
    """armbridge_msgs/srv/BeginTeaching_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/BeginTeaching"
    name: str = ""
    group: str = ""


@dataclass(repr=False)
class GoalCheck(Message):
    """armbridge_msgs/msg/GoalCheck."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/GoalCheck"
    code: int = 0
    message: str = ""
    reachable: bool = False
    free: bool = False
    decided: bool = False
    position_error_m: float = 0.0
    orientation_error_rad: float = 0.0
    duration_s: float = 0.0
    solution: JointState = field(default_factory=JointState)


@dataclass(repr=False)
class CheckGoalsResponse(Message):
    """armbridge_msgs/srv/CheckGoals_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/CheckGoals_Response"
    results: list[GoalCheck] = field(default_factory=list[GoalCheck])


@dataclass(repr=False)
class PoseStamped(Message):
    """geometry_msgs/msg/PoseStamped."""

    TYPE: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass(repr=False)
class CheckGoalsRequest(Service[CheckGoalsResponse]):
    """armbridge_msgs/srv/CheckGoals_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/CheckGoals"
    poses: list[PoseStamped] = field(default_factory=list[PoseStamped])
    joints: list[JointState] = field(default_factory=list[JointState])


@dataclass(repr=False)
class CheckMotionResponse(Message):
    """armbridge_msgs/srv/CheckMotion_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/CheckMotion_Response"
    success: bool = False
    message: str = ""
    duration_s: float = 0.0


@dataclass(repr=False)
class CheckMotionRequest(Service[CheckMotionResponse]):
    """armbridge_msgs/srv/CheckMotion_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/CheckMotion"
    name: str = ""
    speed: float = 0.0


@dataclass(repr=False)
class DeleteMotionResponse(Message):
    """armbridge_msgs/srv/DeleteMotion_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/DeleteMotion_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class DeleteMotionRequest(Service[DeleteMotionResponse]):
    """armbridge_msgs/srv/DeleteMotion_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/DeleteMotion"
    name: str = ""


@dataclass(repr=False)
class DeleteSceneResponse(Message):
    """armbridge_msgs/srv/DeleteScene_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/DeleteScene_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class DeleteSceneRequest(Service[DeleteSceneResponse]):
    """armbridge_msgs/srv/DeleteScene_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/DeleteScene"
    name: str = ""


@dataclass(repr=False)
class EndTeachingResponse(Message):
    """armbridge_msgs/srv/EndTeaching_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/EndTeaching_Response"
    success: bool = False
    message: str = ""
    duration_s: float = 0.0
    points: int = 0


@dataclass(repr=False)
class EndTeachingRequest(Service[EndTeachingResponse]):
    """armbridge_msgs/srv/EndTeaching_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/EndTeaching"


@dataclass(repr=False)
class ListMotionsResponse(Message):
    """armbridge_msgs/srv/ListMotions_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/ListMotions_Response"
    names: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class ListMotionsRequest(Service[ListMotionsResponse]):
    """armbridge_msgs/srv/ListMotions_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/ListMotions"


@dataclass(repr=False)
class ListScenesResponse(Message):
    """armbridge_msgs/srv/ListScenes_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/ListScenes_Response"
    names: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class ListScenesRequest(Service[ListScenesResponse]):
    """armbridge_msgs/srv/ListScenes_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/ListScenes"


@dataclass(repr=False)
class LoadSceneResponse(Message):
    """armbridge_msgs/srv/LoadScene_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/LoadScene_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class LoadSceneRequest(Service[LoadSceneResponse]):
    """armbridge_msgs/srv/LoadScene_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/LoadScene"
    name: str = ""


@dataclass(repr=False)
class GoalTarget(Message):
    """armbridge_msgs/msg/GoalTarget."""

    TYPE: ClassVar[str] = "armbridge_msgs/msg/GoalTarget"
    named: str = ""
    joints: JointState = field(default_factory=JointState)
    pose: PoseStamped = field(default_factory=PoseStamped)


@dataclass(repr=False)
class MoveitGoalResponse(Message):
    """armbridge_msgs/srv/MoveitGoal_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/MoveitGoal_Response"
    success: bool = False
    code: int = 0
    code_name: str = ""
    message: str = ""
    goal_id: str = ""
    duration_s: float = 0.0
    suggested: GoalTarget = field(default_factory=GoalTarget)
    details: list[KeyValue] = field(default_factory=list[KeyValue])


@dataclass(repr=False)
class MoveitGoalRequest(Service[MoveitGoalResponse]):
    """armbridge_msgs/srv/MoveitGoal_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/MoveitGoal"
    named: str = ""
    joints: JointState = field(default_factory=JointState)
    pose: PoseStamped = field(default_factory=PoseStamped)
    group: str = ""
    velocity_scaling: float = 0.0
    acceleration_scaling: float = 0.0
    plan_only: bool = False
    optimization: str = ""
    optimization_time: float = 0.0
    allowed_planning_time: float = 0.0


@dataclass(repr=False)
class RenameMotionResponse(Message):
    """armbridge_msgs/srv/RenameMotion_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/RenameMotion_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class RenameMotionRequest(Service[RenameMotionResponse]):
    """armbridge_msgs/srv/RenameMotion_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/RenameMotion"
    name: str = ""
    new_name: str = ""


@dataclass(repr=False)
class SaveSceneResponse(Message):
    """armbridge_msgs/srv/SaveScene_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SaveScene_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class SaveSceneRequest(Service[SaveSceneResponse]):
    """armbridge_msgs/srv/SaveScene_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SaveScene"
    name: str = ""


@dataclass(repr=False)
class SetBodyResponse(Message):
    """armbridge_msgs/srv/SetBody_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetBody_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class SetBodyRequest(Service[SetBodyResponse]):
    """armbridge_msgs/srv/SetBody_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetBody"
    id: str = ""
    movable: bool = False
    mass: float = 0.0
    friction: float = 0.0


@dataclass(repr=False)
class SetBodyPoseResponse(Message):
    """armbridge_msgs/srv/SetBodyPose_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetBodyPose_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class SetBodyPoseRequest(Service[SetBodyPoseResponse]):
    """armbridge_msgs/srv/SetBodyPose_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetBodyPose"
    id: str = ""
    pose: Pose = field(default_factory=Pose)


@dataclass(repr=False)
class SetSpeedLimitResponse(Message):
    """armbridge_msgs/srv/SetSpeedLimit_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetSpeedLimit_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class SetSpeedLimitRequest(Service[SetSpeedLimitResponse]):
    """armbridge_msgs/srv/SetSpeedLimit_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/SetSpeedLimit"
    speed_limit: float = 0.0


@dataclass(repr=False)
class StartEpisodeResponse(Message):
    """armbridge_msgs/srv/StartEpisode_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StartEpisode_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class StartEpisodeRequest(Service[StartEpisodeResponse]):
    """armbridge_msgs/srv/StartEpisode_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StartEpisode"
    task: str = ""


@dataclass(repr=False)
class StartTeleopResponse(Message):
    """armbridge_msgs/srv/StartTeleop_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StartTeleop_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class StartTeleopRequest(Service[StartTeleopResponse]):
    """armbridge_msgs/srv/StartTeleop_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StartTeleop"
    follower: str = ""
    leader: str = ""
    scale: float = 0.0
    mirror: bool = False
    leader_joints: list[str] = field(default_factory=list[str])
    follower_joints: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class StepSimulationResponse(Message):
    """armbridge_msgs/srv/StepSimulation_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StepSimulation_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class StepSimulationRequest(Service[StepSimulationResponse]):
    """armbridge_msgs/srv/StepSimulation_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/StepSimulation"
    steps: int = 0


@dataclass(repr=False)
class TrimMotionResponse(Message):
    """armbridge_msgs/srv/TrimMotion_Response."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/TrimMotion_Response"
    success: bool = False
    message: str = ""
    duration_s: float = 0.0


@dataclass(repr=False)
class TrimMotionRequest(Service[TrimMotionResponse]):
    """armbridge_msgs/srv/TrimMotion_Request."""

    TYPE: ClassVar[str] = "armbridge_msgs/srv/TrimMotion"
    name: str = ""
    from_s: float = 0.0
    to_s: float = 0.0


@dataclass(repr=False)
class ApplyPlanningSceneResponse(Message):
    """moveit_msgs/srv/ApplyPlanningScene_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/ApplyPlanningScene_Response"
    success: bool = False


@dataclass(repr=False)
class ApplyPlanningSceneRequest(Service[ApplyPlanningSceneResponse]):
    """moveit_msgs/srv/ApplyPlanningScene_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/ApplyPlanningScene"
    scene: PlanningScene = field(default_factory=PlanningScene)


@dataclass(repr=False)
class DeleteRobotStateFromWarehouseResponse(Message):
    """moveit_msgs/srv/DeleteRobotStateFromWarehouse_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/DeleteRobotStateFromWarehouse_Response"


@dataclass(repr=False)
class DeleteRobotStateFromWarehouseRequest(Service[DeleteRobotStateFromWarehouseResponse]):
    """moveit_msgs/srv/DeleteRobotStateFromWarehouse_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/DeleteRobotStateFromWarehouse"
    name: str = ""
    robot: str = ""


@dataclass(repr=False)
class RobotTrajectory(Message):
    """moveit_msgs/msg/RobotTrajectory."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/RobotTrajectory"
    joint_trajectory: JointTrajectory = field(default_factory=JointTrajectory)


@dataclass(repr=False)
class GetCartesianPathResponse(Message):
    """moveit_msgs/srv/GetCartesianPath_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetCartesianPath_Response"
    solution: RobotTrajectory = field(default_factory=RobotTrajectory)
    fraction: float = 0.0
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)


@dataclass(repr=False)
class GetCartesianPathRequest(Service[GetCartesianPathResponse]):
    """moveit_msgs/srv/GetCartesianPath_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetCartesianPath"
    header: Header = field(default_factory=Header)
    group_name: str = ""
    link_name: str = ""
    waypoints: list[Pose] = field(default_factory=list[Pose])
    max_step: float = 0.0
    avoid_collisions: bool = False
    max_velocity_scaling_factor: float = 0.0
    max_acceleration_scaling_factor: float = 0.0


@dataclass(repr=False)
class MotionPlanResponse(Message):
    """moveit_msgs/msg/MotionPlanResponse."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/MotionPlanResponse"
    trajectory: RobotTrajectory = field(default_factory=RobotTrajectory)
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)


@dataclass(repr=False)
class GetMotionPlanResponse(Message):
    """moveit_msgs/srv/GetMotionPlan_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetMotionPlan_Response"
    motion_plan_response: MotionPlanResponse = field(default_factory=MotionPlanResponse)


@dataclass(repr=False)
class JointConstraint(Message):
    """moveit_msgs/msg/JointConstraint."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/JointConstraint"
    joint_name: str = ""
    position: float = 0.0
    tolerance_above: float = 0.0
    tolerance_below: float = 0.0
    weight: float = 0.0


@dataclass(repr=False)
class BoundingVolume(Message):
    """moveit_msgs/msg/BoundingVolume."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/BoundingVolume"
    primitives: list[SolidPrimitive] = field(default_factory=list[SolidPrimitive])
    primitive_poses: list[Pose] = field(default_factory=list[Pose])
    meshes: list[Mesh] = field(default_factory=list[Mesh])
    mesh_poses: list[Pose] = field(default_factory=list[Pose])


@dataclass(repr=False)
class PositionConstraint(Message):
    """moveit_msgs/msg/PositionConstraint."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/PositionConstraint"
    header: Header = field(default_factory=Header)
    link_name: str = ""
    target_point_offset: Vector3 = field(default_factory=Vector3)
    constraint_region: BoundingVolume = field(default_factory=BoundingVolume)
    weight: float = 0.0


@dataclass(repr=False)
class OrientationConstraint(Message):
    """moveit_msgs/msg/OrientationConstraint."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/OrientationConstraint"
    header: Header = field(default_factory=Header)
    orientation: Quaternion = field(default_factory=Quaternion)
    link_name: str = ""
    absolute_x_axis_tolerance: float = 0.0
    absolute_y_axis_tolerance: float = 0.0
    absolute_z_axis_tolerance: float = 0.0
    parameterization: int = 0
    weight: float = 0.0


@dataclass(repr=False)
class Constraints(Message):
    """moveit_msgs/msg/Constraints."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/Constraints"
    joint_constraints: list[JointConstraint] = field(default_factory=list[JointConstraint])
    position_constraints: list[PositionConstraint] = field(default_factory=list[PositionConstraint])
    orientation_constraints: list[OrientationConstraint] = field(default_factory=list[OrientationConstraint])


@dataclass(repr=False)
class MotionPlanRequest(Message):
    """moveit_msgs/msg/MotionPlanRequest."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/MotionPlanRequest"
    goal_constraints: list[Constraints] = field(default_factory=list[Constraints])
    group_name: str = ""
    max_velocity_scaling_factor: float = 0.0
    max_acceleration_scaling_factor: float = 0.0


@dataclass(repr=False)
class GetMotionPlanRequest(Service[GetMotionPlanResponse]):
    """moveit_msgs/srv/GetMotionPlan_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetMotionPlan"
    motion_plan_request: MotionPlanRequest = field(default_factory=MotionPlanRequest)


@dataclass(repr=False)
class GetPlanningSceneResponse(Message):
    """moveit_msgs/srv/GetPlanningScene_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetPlanningScene_Response"
    scene: PlanningScene = field(default_factory=PlanningScene)


@dataclass(repr=False)
class PlanningSceneComponents(Message):
    """moveit_msgs/msg/PlanningSceneComponents."""

    TYPE: ClassVar[str] = "moveit_msgs/msg/PlanningSceneComponents"
    components: int = 0


@dataclass(repr=False)
class GetPlanningSceneRequest(Service[GetPlanningSceneResponse]):
    """moveit_msgs/srv/GetPlanningScene_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetPlanningScene"
    components: PlanningSceneComponents = field(default_factory=PlanningSceneComponents)


@dataclass(repr=False)
class GetPositionFKResponse(Message):
    """moveit_msgs/srv/GetPositionFK_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetPositionFK_Response"
    pose_stamped: list[PoseStamped] = field(default_factory=list[PoseStamped])
    fk_link_names: list[str] = field(default_factory=list[str])
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)


@dataclass(repr=False)
class GetPositionFKRequest(Service[GetPositionFKResponse]):
    """moveit_msgs/srv/GetPositionFK_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/GetPositionFK"
    header: Header = field(default_factory=Header)
    fk_link_names: list[str] = field(default_factory=list[str])
    robot_state: RobotState = field(default_factory=RobotState)


@dataclass(repr=False)
class SaveRobotStateToWarehouseResponse(Message):
    """moveit_msgs/srv/SaveRobotStateToWarehouse_Response."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/SaveRobotStateToWarehouse_Response"
    success: bool = False


@dataclass(repr=False)
class SaveRobotStateToWarehouseRequest(Service[SaveRobotStateToWarehouseResponse]):
    """moveit_msgs/srv/SaveRobotStateToWarehouse_Request."""

    TYPE: ClassVar[str] = "moveit_msgs/srv/SaveRobotStateToWarehouse"
    name: str = ""


@dataclass(repr=False)
class TopicsForTypeResponse(Message):
    """rosapi_msgs/srv/TopicsForType_Response."""

    TYPE: ClassVar[str] = "rosapi_msgs/srv/TopicsForType_Response"
    topics: list[str] = field(default_factory=list[str])


@dataclass(repr=False)
class TopicsForTypeRequest(Service[TopicsForTypeResponse]):
    """rosapi_msgs/srv/TopicsForType_Request."""

    TYPE: ClassVar[str] = "rosapi_msgs/srv/TopicsForType"
    type: str = ""


@dataclass(repr=False)
class SetBoolResponse(Message):
    """std_srvs/srv/SetBool_Response."""

    TYPE: ClassVar[str] = "std_srvs/srv/SetBool_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class SetBoolRequest(Service[SetBoolResponse]):
    """std_srvs/srv/SetBool_Request."""

    TYPE: ClassVar[str] = "std_srvs/srv/SetBool"
    data: bool = False


@dataclass(repr=False)
class TriggerResponse(Message):
    """std_srvs/srv/Trigger_Response."""

    TYPE: ClassVar[str] = "std_srvs/srv/Trigger_Response"
    success: bool = False
    message: str = ""


@dataclass(repr=False)
class TriggerRequest(Service[TriggerResponse]):
    """std_srvs/srv/Trigger_Request."""

    TYPE: ClassVar[str] = "std_srvs/srv/Trigger"


@dataclass(repr=False)
class MoveitGoalResult(Message):
    """armbridge_msgs/action/MoveitGoal_Result."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/MoveitGoal_Result"
    success: bool = False
    code: int = 0
    code_name: str = ""
    message: str = ""
    goal_id: str = ""
    duration_s: float = 0.0
    suggested: GoalTarget = field(default_factory=GoalTarget)
    details: list[KeyValue] = field(default_factory=list[KeyValue])


@dataclass(repr=False)
class MoveitGoalFeedback(Message):
    """armbridge_msgs/action/MoveitGoal_Feedback."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/MoveitGoal_Feedback"
    state: str = ""
    message: str = ""
    fraction: float = 0.0
    seconds_left: float = 0.0


@dataclass(repr=False)
class MoveitGoalGoal(Action[MoveitGoalResult, MoveitGoalFeedback]):
    """armbridge_msgs/action/MoveitGoal_Goal."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/MoveitGoal"
    named: str = ""
    joints: JointState = field(default_factory=JointState)
    pose: PoseStamped = field(default_factory=PoseStamped)
    group: str = ""
    velocity_scaling: float = 0.0
    acceleration_scaling: float = 0.0
    plan_only: bool = False
    optimization: str = ""
    optimization_time: float = 0.0
    allowed_planning_time: float = 0.0


@dataclass(repr=False)
class ReplayMotionResult(Message):
    """armbridge_msgs/action/ReplayMotion_Result."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/ReplayMotion_Result"
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)
    message: str = ""


@dataclass(repr=False)
class ReplayMotionFeedback(Message):
    """armbridge_msgs/action/ReplayMotion_Feedback."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/ReplayMotion_Feedback"
    state: str = ""
    fraction: float = 0.0
    remaining_s: float = 0.0


@dataclass(repr=False)
class ReplayMotionGoal(Action[ReplayMotionResult, ReplayMotionFeedback]):
    """armbridge_msgs/action/ReplayMotion_Goal."""

    TYPE: ClassVar[str] = "armbridge_msgs/action/ReplayMotion"
    name: str = ""
    speed: float = 0.0
    reverse: bool = False
    repeat: int = 0


@dataclass(repr=False)
class GripperCommandResult(Message):
    """control_msgs/action/GripperCommand_Result."""

    TYPE: ClassVar[str] = "control_msgs/action/GripperCommand_Result"
    position: float = 0.0
    effort: float = 0.0
    stalled: bool = False
    reached_goal: bool = False


@dataclass(repr=False)
class GripperCommandFeedback(Message):
    """control_msgs/action/GripperCommand_Feedback."""

    TYPE: ClassVar[str] = "control_msgs/action/GripperCommand_Feedback"
    position: float = 0.0
    effort: float = 0.0
    stalled: bool = False
    reached_goal: bool = False


@dataclass(repr=False)
class GripperCommand(Message):
    """control_msgs/msg/GripperCommand."""

    TYPE: ClassVar[str] = "control_msgs/msg/GripperCommand"
    position: float = 0.0
    max_effort: float = 0.0


@dataclass(repr=False)
class GripperCommandGoal(Action[GripperCommandResult, GripperCommandFeedback]):
    """control_msgs/action/GripperCommand_Goal."""

    TYPE: ClassVar[str] = "control_msgs/action/GripperCommand"
    command: GripperCommand = field(default_factory=GripperCommand)


@dataclass(repr=False)
class ExecuteTrajectoryResult(Message):
    """moveit_msgs/action/ExecuteTrajectory_Result."""

    TYPE: ClassVar[str] = "moveit_msgs/action/ExecuteTrajectory_Result"
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)


@dataclass(repr=False)
class ExecuteTrajectoryFeedback(Message):
    """moveit_msgs/action/ExecuteTrajectory_Feedback."""

    TYPE: ClassVar[str] = "moveit_msgs/action/ExecuteTrajectory_Feedback"
    state: str = ""


@dataclass(repr=False)
class ExecuteTrajectoryGoal(Action[ExecuteTrajectoryResult, ExecuteTrajectoryFeedback]):
    """moveit_msgs/action/ExecuteTrajectory_Goal."""

    TYPE: ClassVar[str] = "moveit_msgs/action/ExecuteTrajectory"
    trajectory: RobotTrajectory = field(default_factory=RobotTrajectory)
    controller_names: list[str] = field(default_factory=list[str])


# Hashes of the types and of all types in them, as the server lists them.
TYPES = {
    "armbridge_msgs/msg/ActionChunk": "RIHS01_8b7b453c8f6fdb5ad2363714572bff246a8b3160566d0132f147aa526b6ab853",
    "armbridge_msgs/msg/ActionChunkAnswer": "RIHS01_70fb0e9a3d52cf991f114e040a881aa53322dfba0a76e0a26da56e3fc0f070f6",
    "armbridge_msgs/msg/TeachState": "RIHS01_c6ae90716c647074247722b2b2e4eb8a785d56aedb67f7470297a26c2bae374b",
    "armbridge_msgs/msg/TeleopState": "RIHS01_e24a43ef2f16edeb257972f78a741bf6bea5318e440f32f8bd845afb96097b75",
    "control_msgs/msg/JointJog": "RIHS01_ba249455a20f70168a1acb7bf43b776b72ff1f7eb5fc4cfea443f749e963c6e7",
    "control_msgs/msg/JointTrajectoryControllerState": "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    "diagnostic_msgs/msg/DiagnosticStatus": "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4",
    "geometry_msgs/msg/TwistStamped": "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "moveit_msgs/msg/KinematicSolverInfo": "RIHS01_aff881f3a471d41cfa243cb8905aeae03eced10ae1f24661384f72d5c17fbaf2",
    "moveit_msgs/msg/MoveItErrorCodes": "RIHS01_dcda8a9950cf6dd6ac221c2c0d2509f52f136afa0403dd19beacdf07e83e4a07",
    "moveit_msgs/msg/PlanningScene": "RIHS01_0f58540ad5eab4b9ea827d53b763c793d8cabd202b3b301fcee25afa4ce1bd80",
    "moveit_msgs/msg/ServoStatus": "RIHS01_882a75f7648d6f8a9bf528e4787f51c58f2d5d88b702e450443d99f270e6936b",
    "sensor_msgs/msg/CompressedImage": "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "std_msgs/msg/Bool": "RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "std_msgs/msg/Empty": "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "std_msgs/msg/Float64": "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "armbridge_msgs/srv/BeginTeaching": "RIHS01_81b529b29a0739780ab8a712a095804895eb182d24a30c8ecf0ce9ecd5e9a70c",
    "armbridge_msgs/srv/CheckGoals": "RIHS01_d288d62c75b87f11ad563e0e097051772d062d1939a58080dfe344fef96b8c7d",
    "armbridge_msgs/srv/CheckMotion": "RIHS01_5b53c59ad369bf74abb1be9b282114585d7de3c3f891a61e6f31188b0771c26e",
    "armbridge_msgs/srv/DeleteMotion": "RIHS01_1cd560727f37d4cc1928da22e5ffd4ea738e9964562ab67e75b63b9e03d4779d",
    "armbridge_msgs/srv/DeleteScene": "RIHS01_d997fae7a3240cadf8e27f7a157a45c41fe843a4cfc8f0e7ee462926eb027b95",
    "armbridge_msgs/srv/EndTeaching": "RIHS01_a44bbc5b25e30e657600677a97dd3edcdc9825b2c739b5b17a06d2bed3ae3dd3",
    "armbridge_msgs/srv/ListMotions": "RIHS01_521f619ef0434edf29c5be8280d81569daa51fadb47e53cd01ec68180f339f1e",
    "armbridge_msgs/srv/ListScenes": "RIHS01_01c28a5e695338a2076d7d043b3cca3706e47cfc457f0cddbe7b6d50563e2abd",
    "armbridge_msgs/srv/LoadScene": "RIHS01_e81781459f3f23949f6ab09a5a726faa0f6c5878fb18a8c4f7b1bc902b4c5236",
    "armbridge_msgs/srv/MoveitGoal": "RIHS01_6c513c6658820436306050c28a73097c02a69a41fa5bec412bfce870177cd98b",
    "armbridge_msgs/srv/RenameMotion": "RIHS01_9cfc125556ae3f7fb871d9ac820e7317279e66e6a70b794cea6abb6c8edd7942",
    "armbridge_msgs/srv/SaveScene": "RIHS01_0f3e0d3e69414aa970d94587c6517cd6df917019d1376c862d4874e85824f07c",
    "armbridge_msgs/srv/SetBody": "RIHS01_53fc1dd708222dae818d32d54e62b279d9aa59ecc500b351b02516fe5195795d",
    "armbridge_msgs/srv/SetBodyPose": "RIHS01_9a008ddf043d8b142412a8df48bed7df79aa9f80dc7da763dc7af9db3ab4f8c8",
    "armbridge_msgs/srv/SetSpeedLimit": "RIHS01_278c041a0080c5fe5b3722c2794092dd07827879abffc9f4ff39f2f5f460773d",
    "armbridge_msgs/srv/StartEpisode": "RIHS01_274175baa6bcbfaafffee23f172500b367040591c83c2005037ea74d83abccd7",
    "armbridge_msgs/srv/StartTeleop": "RIHS01_65c0f5ca819224890a227d34ccd309fc64603c0b7807ccfe52dbcb04e2478dd6",
    "armbridge_msgs/srv/StepSimulation": "RIHS01_c0957edd4f335f6019a7481e50eaf9b8bbb6ad1a3096808ca95d9a9c4f3bfe20",
    "armbridge_msgs/srv/TrimMotion": "RIHS01_7bd9c987c044996664fd91a41761aedcf6d8900acde90d1901b22dbc875b0f51",
    "moveit_msgs/srv/ApplyPlanningScene": "RIHS01_8e6134783db0987c0acedbfd2f16f608a8f7a54e83a7bbb372e851af419f4d72",
    "moveit_msgs/srv/DeleteRobotStateFromWarehouse": "RIHS01_1c32a06d4ffa8740f355556542fd73d146cb80ff35d9c9529d0620e636bb47a7",
    "moveit_msgs/srv/GetCartesianPath": "RIHS01_b19f501df5d378141d918199894c3ad24533e76021a880b15dc5d62fec8d7b1a",
    "moveit_msgs/srv/GetMotionPlan": "RIHS01_0e118e1d8d53d5fea8eea309fc06a58239fa0e617864127e7de8399ab7335b27",
    "moveit_msgs/srv/GetPlanningScene": "RIHS01_7ed7e96238b902174d985b0eb739ea08c95377e8e46a6a9014c22497faf79cd2",
    "moveit_msgs/srv/GetPositionFK": "RIHS01_2f16ec361a135d84b85a29385abeb9eeb025e39c09038bd6b2826645edc7edad",
    "moveit_msgs/srv/SaveRobotStateToWarehouse": "RIHS01_038b704d5b0a3b81f91ddf02d7f0bb09b8112fe97ae583426b13514ca2c85626",
    "rosapi_msgs/srv/TopicsForType": "RIHS01_30f193f32508dd6c9ef428326f00d0aef2f585d15436fec65b262e6ddce20c96",
    "std_srvs/srv/SetBool": "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "armbridge_msgs/action/MoveitGoal": "sha256_b6aa2ed0a4a27ae9aec82fbac9ec5bf56208c85342a56869921d7f336659d1ba",
    "armbridge_msgs/action/ReplayMotion": "sha256_52d8cbd41d5aff94ae5a5e24a019d195fe3e4d63c19ae55f2da20ca0a42e85a7",
    "control_msgs/action/GripperCommand": "sha256_43ae36a13e9ac415c0e1f14f3f59eea8d081df52bf045c4bdb594d21cab80af7",
    "moveit_msgs/action/ExecuteTrajectory": "sha256_497ed3653708daa5dd868551a037f35ffe15bb594065168359cc83438ab71ce8",
}
