"""``/tf`` and ``/tf_static``: where each link stands on the one before it, for clients that draw the arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocol.messages import Stamp
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.messages import ArmState
from robot.trajectory import Vector
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.poses import pose_of

TRANSFORMS_TOPIC = "/tf"
STATIC_TRANSFORMS_TOPIC = "/tf_static"

# A state that is due a little early still counts.
EARLY_S = 0.005


class TransformsTopics:
    """Publishes the arm's transforms: those of joints that move with the joint states, the others once.

    Args:
        graph: where the topics are.
        robot: the arm.
        rate_hz: how often at most those that move are told [Hz].
    """

    def __init__(self, graph: Graph, robot: RobotModel, rate_hz: float) -> None:
        self._graph = graph
        self._period_s = 1.0 / rate_hz
        self._placements = ForwardPlacements(robot)
        joints = robot.joints.values()
        self._moving = [joint.child for joint in joints if joint.movable]
        self._fixed = [joint.child for joint in joints if not joint.movable]
        self._node = Node("robot state publisher")
        self._published_s = 0.0

    def open(self, now_s: float) -> None:
        """Advertise, and publish the transforms that never change.

        Args:
            now_s: wall-clock time [s since the epoch].
        """
        self._graph.advertise(self._node, TRANSFORMS_TOPIC, "tf2_msgs/TFMessage")
        self._graph.advertise(self._node, STATIC_TRANSFORMS_TOPIC, "tf2_msgs/TFMessage", latch=True)
        self._graph.publish(self._node, STATIC_TRANSFORMS_TOPIC, self._message(self._fixed, {}, now_s))

    def take_state(self, state: ArmState) -> None:
        """Publish a state of the arm, when somebody listens and it is time."""
        if state.position_rad is None or not self._graph.subscribers(TRANSFORMS_TOPIC):
            return
        # A clock that was set back must not silence the topic.
        if 0.0 <= state.stamp_s - self._published_s < self._period_s - EARLY_S:
            return
        self._published_s = state.stamp_s
        positions_rad = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
        self._graph.publish(self._node, TRANSFORMS_TOPIC, self._message(self._moving, positions_rad, state.stamp_s))

    def _message(self, links: list[str], positions_rad: Mapping[str, float], stamp_s: float) -> dict[str, Any]:
        stamp = Stamp.from_seconds(stamp_s).as_message()
        transforms = []
        for link in links:
            parent, transform_link_to_parent = self._placements.joint_transform(link, positions_rad)
            transforms.append(
                {
                    "header": {"stamp": stamp, "frame_id": parent},
                    "child_frame_id": link,
                    "transform": _transform(transform_link_to_parent),
                }
            )
        return {"transforms": transforms}


def _transform(transform: Vector) -> dict[str, Any]:
    """The geometry_msgs/Transform of a matrix, shape (4, 4) [m]."""
    pose = pose_of(transform)
    return {
        "translation": dict(zip("xyz", pose.position_m, strict=True)),
        "rotation": dict(zip("xyzw", pose.orientation, strict=True)),
    }
