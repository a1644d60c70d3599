"""The state of the arm's controller as ros2_control publishes it: where the joints should be, and where they are."""

from __future__ import annotations

from typing import Any

from protocol.messages import Stamp
from robot.description.model import Group
from robot.messages import ArmState
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.followed_goal import point

STATE_TYPE = "control_msgs/JointTrajectoryControllerState"


class ControllerState:
    """Publishes the topic, with every state of the arm, while somebody listens.

    Args:
        graph: where it is.
        group: the joints that are controlled.
    """

    def __init__(self, graph: Graph, group: Group) -> None:
        self._graph = graph
        self._joints = group.joints
        self._node = Node(f"{group.name} controller")
        # ROS 2's name, and ROS 1's.
        self._topics = (f"/{group.name}_controller/controller_state", f"/{group.name}_controller/state")

    def open(self) -> None:
        """Advertise it under both names."""
        for topic in self._topics:
            self._graph.advertise(self._node, topic, STATE_TYPE)

    def take_state(self, state: ArmState) -> None:
        """Publish a state of the arm."""
        message: dict[str, Any] | None = None
        for topic in self._topics:
            if self._graph.subscribers(topic):
                message = message or self._message(state)
                if message is not None:
                    self._graph.publish(self._node, topic, message)

    def _message(self, state: ArmState) -> dict[str, Any] | None:
        if state.goal_rad is None or state.position_rad is None or state.velocity_rad_s is None:
            return None
        columns = [state.joint_names.index(name) for name in self._joints]
        reference, feedback = state.goal_rad[columns], state.position_rad[columns]
        return {
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "joint_names": list(self._joints),
            "reference": point(reference),
            "feedback": {**point(feedback), "velocities": state.velocity_rad_s[columns].tolist()},
            "error": point(reference - feedback),
            "speed_scaling_factor": state.pace.speed_factor,
        }
