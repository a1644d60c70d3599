"""A ROS 2 node that uses the arm through the bridge; the last line of the output has what it saw."""

import json
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String
from std_srvs.srv import Trigger

TIMEOUT_S = 120.0

rclpy.init()
node = Node("scenario")
seen: dict[str, Any] = {}
ends: list[tuple[str, str]] = []


def end(status: DiagnosticStatus) -> None:
    """Keep the code and the sentence of a goal that is done."""
    values = {each.key: each.value for each in status.values}
    if values["state"] == "done":
        ends.append((values["code"], status.message))


def spin(until: Callable[[], object]) -> None:
    """Take messages until something is true."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while not until():
        if time.monotonic() > deadline_s:
            raise SystemExit(f"waited for {TIMEOUT_S:g} s: {seen} {ends}")
        rclpy.spin_once(node, timeout_sec=0.1)


latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# The joints last: the bridge hears of subscriptions in their order, and has found the others once there are joints.
node.create_subscription(String, "/robot_description", lambda message: seen.update(urdf=message), latched)
node.create_subscription(DiagnosticStatus, "/moveit_goal_status", end, 10)
node.create_subscription(JointState, "/joint_states", lambda message: seen.update(joints=message), 10)
named = node.create_publisher(String, "/moveit_goal_named", 10)
joints = node.create_publisher(JointState, "/moveit_goal_joints", 10)
stop = node.create_publisher(Empty, "/stop", 10)
stop_service = node.create_client(Trigger, "/arm/stop")

spin(lambda: len(seen) == 2)
spin(lambda: all(each.get_subscription_count() for each in (named, joints, stop)))
spin(lambda: node.count_publishers("/moveit_goal_status"))
named.publish(String(data="ready"))
spin(lambda: len(ends) == 1)
joints.publish(JointState(name=["shoulder_pan"], position=[0.5]))
spin(lambda: len(ends) == 2)
reached = dict(zip(seen["joints"].name, seen["joints"].position, strict=True))
joints.publish(JointState(name=["shoulder_pan"], position=[-1.5]))
stop.publish(Empty())
spin(lambda: len(ends) == 3)
stop_service.wait_for_service(TIMEOUT_S)
answer = stop_service.call_async(Trigger.Request())
spin(answer.done)
print(
    json.dumps(
        {
            "ends": ends,
            "shoulder_pan": reached["shoulder_pan"],
            "urdf": seen["urdf"].data[:80],
            "stop": [answer.result().success, answer.result().message],
        }
    )
)
