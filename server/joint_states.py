"""``/joint_states`` from what the servos report."""

from __future__ import annotations

from typing import Any

from protocol.messages import Stamp
from robot.messages import ArmState
from server.graph_topics import Graph
from server.node import Node

TOPIC = "/joint_states"


class JointStates:
    """Publishes every state of the arm.

    Effort is the share of full motor duty, -1..1: the servos measure no torque.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._node = Node("arm")

    def open(self) -> None:
        """Advertise the topic."""
        self._graph.advertise(self._node, TOPIC, "sensor_msgs/JointState")

    def publish(self, state: ArmState) -> None:
        """Publish one state; a disconnected arm has none."""
        if state.position_rad is None or state.velocity_rad_s is None or state.load is None:
            return
        message: dict[str, Any] = {
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "name": list(state.joint_names),
            "position": state.position_rad.tolist(),
            "velocity": state.velocity_rad_s.tolist(),
            "effort": state.load.tolist(),
        }
        self._graph.publish(self._node, TOPIC, message)
