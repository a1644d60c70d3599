"""Action clients of ROS 2 move the arm through the bridge; the last line of the output has what they got."""

import json
import time
from collections.abc import Callable
from typing import Any

import rclpy
from control_msgs.action import FollowJointTrajectory, GripperCommand
from geometry_msgs.msg import Pose
from moveit_msgs.action import MoveGroup
from moveit_msgs.msg import CollisionObject, Constraints, JointConstraint, PlanningScene
from moveit_msgs.srv import GetPositionFK
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectoryPoint

TIMEOUT_S = 120.0

rclpy.init()
node = Node("scenario")


def spin(until: Callable[[], object]) -> None:
    """Take messages until something is true."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while not until():
        if time.monotonic() > deadline_s:
            raise SystemExit(f"waited for {TIMEOUT_S:g} s")
        rclpy.spin_once(node, timeout_sec=0.1)


def wait(future: Any) -> Any:
    """Return the result of a future."""
    spin(future.done)
    return future.result()


def carry_out(action: Any, name: str, goal: Any, end: Callable[[Any], Any] | None = None) -> tuple[int, Any, int]:
    """Return status, result and number of feedback messages; after the first feedback end the goal."""
    client = ActionClient(node, action, name)
    spin(client.server_is_ready)
    feedback: list[Any] = []
    handle = wait(client.send_goal_async(goal, feedback.append))
    if end is not None:
        spin(lambda: feedback)
        end(handle)
    answer = wait(handle.get_result_async())
    return answer.status, answer.result, len(feedback)


def path(position_rad: float, duration_s: int) -> FollowJointTrajectory.Goal:
    """Return a trajectory of one joint from where the arm stands."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = ["shoulder_pan"]
    point = JointTrajectoryPoint(positions=[position_rad])
    point.time_from_start.sec = duration_s
    goal.trajectory.points = [point]
    return goal


# A subscription is found in its own time, here and by the bridge, and a scene is published once, when it changes. The
# bridge hears of these in their order: it has found the scene's once there are joints, which it passes on when it has
# its server.
scenes: list[PlanningScene] = []
node.create_subscription(PlanningScene, "/monitored_planning_scene", scenes.append, 10)
states: list[JointState] = []
node.create_subscription(JointState, "/joint_states", states.append, 10)
spin(lambda: states)
FOLLOW = "/arm_controller/follow_joint_trajectory"
status, result, count = carry_out(FollowJointTrajectory, FOLLOW, path(0.5, 1))
seen: dict[str, Any] = {"followed": [status, result.error_code, count > 0]}
status, result, count = carry_out(FollowJointTrajectory, FOLLOW, path(-0.5, 30), lambda goal: goal.cancel_goal_async())
seen["cancelled"] = status
# As MoveGroupInterface and pymoveit2 stop.
events = node.create_publisher(String, "/trajectory_execution_event", 1)
spin(events.get_subscription_count)
status, result, count = carry_out(
    FollowJointTrajectory, FOLLOW, path(-0.5, 30), lambda _: events.publish(String(data="stop"))
)
seen["stopped"] = [status, result.error_string]
status, result, count = carry_out(FollowJointTrajectory, FOLLOW, path(9.0, 5))
seen["refused"] = [status, result.error_string]
gripper = GripperCommand.Goal()
gripper.command.position = 1.0
status, result, count = carry_out(GripperCommand, "/gripper_controller/gripper_cmd", gripper)
seen["gripper"] = [status, result.reached_goal, round(result.position, 1)]
move = MoveGroup.Goal()
move.request.group_name = "arm"
move.request.goal_constraints = [
    Constraints(joint_constraints=[JointConstraint(joint_name="shoulder_pan", position=0.3, weight=1.0)])
]
status, result, count = carry_out(MoveGroup, "/move_action", move)
seen["moved"] = [status, result.error_code.val, len(result.planned_trajectory.joint_trajectory.points) > 2]
kinematics = node.create_client(GetPositionFK, "/compute_fk")
kinematics.wait_for_service(TIMEOUT_S)
poses = wait(kinematics.call_async(GetPositionFK.Request(fk_link_names=["gripper_frame_link"])))
seen["pose"] = [poses.error_code.val, poses.pose_stamped[0].header.frame_id]
poses = wait(kinematics.call_async(GetPositionFK.Request(fk_link_names=["gripper_link"] * 300)))
seen["too many"] = [poses.error_code.val, poses.error_code.message]
# A box around the tip, as pymoveit2 adds it.
box = CollisionObject(id="box", operation=CollisionObject.ADD)
box.header.frame_id = "gripper_frame_link"
box.primitives, box.primitive_poses = [SolidPrimitive(type=SolidPrimitive.BOX, dimensions=[0.1, 0.1, 0.1])], [Pose()]
objects = node.create_publisher(CollisionObject, "/collision_object", 10)
spin(objects.get_subscription_count)
objects.publish(box)
spin(lambda: any(each.world.collision_objects for each in scenes))
status, result, count = carry_out(MoveGroup, "/move_action", move)
seen["in contact"] = [status, result.error_code.val]
objects.publish(CollisionObject(id="box", operation=CollisionObject.REMOVE))
print(json.dumps(seen))
