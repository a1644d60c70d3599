"""What viewers show of planning: the planned motion as a ghost, and what touches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from protocol.messages import Stamp
from robot.description.model import RobotModel
from robot.trajectory import Trajectory
from server.goal_queue import Performed
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.current_state import state_message
from server.moveit.requests.context import Message
from server.moveit.requests.trajectories import to_message

PATH_TOPIC = "/display_planned_path"
CONTACTS_TOPIC = "/display_contacts"
PIPELINE_TOPIC = "/pipeline_state"

# MoveIt has a stage for each adapter; here is one for all.
PIPELINE_STAGE = "armbridge"

# visualization_msgs/Marker.
SPHERE, ADD, DELETE_ALL = 2, 0, 3

# As MoveIt shows them: visible beside an arm of half a metre, and gone before they are taken for the present.
CONTACT_DIAMETER_M = 0.02
CONTACT_LIFETIME_S = 10
CONTACT_COLOR = {"r": 1.0, "g": 0.0, "b": 0.0, "a": 0.7}


class DisplayTopics:
    """Publishes what viewers show.

    Args:
        graph: where the topics are.
        robot: the arm.
    """

    def __init__(self, graph: Graph, robot: RobotModel) -> None:
        self._graph = graph
        self._robot = robot
        self._node = Node("display")

    def open(self) -> None:
        """Advertise the topics."""
        self._graph.advertise(self._node, PATH_TOPIC, "moveit_msgs/DisplayTrajectory", latch=True)
        self._graph.advertise(self._node, CONTACTS_TOPIC, "visualization_msgs/MarkerArray")
        self._graph.advertise(self._node, PIPELINE_TOPIC, "moveit_msgs/PipelineState")

    def performed(self, performed: Performed) -> None:
        """Show what is about to be carried out."""
        self.planned(performed.planned, performed.start_rad)

    def planned(self, motions: Sequence[Trajectory], start_rad: Mapping[str, float]) -> None:
        """Show planned motions, one after the other.

        Args:
            motions: the motions.
            start_rad: position of every movable joint where the first one begins [rad].
        """
        root = self._robot.root_link
        message = {
            "model_id": self._robot.name,
            "trajectory": [to_message(motion, root) for motion in motions],
            "trajectory_start": state_message(dict(start_rad), root, 0.0),
        }
        self._graph.publish(self._node, PATH_TOPIC, message)

    def pipeline(self, request: Message, response: Message) -> None:
        """Tell what was asked of the planners and what they answered, to whoever listens.

        Args:
            request: a moveit_msgs/MotionPlanRequest.
            response: the moveit_msgs/MotionPlanResponse to it.
        """
        if self._graph.subscribers(PIPELINE_TOPIC):
            state = {"request": request, "response": response, "pipeline_stage": PIPELINE_STAGE}
            self._graph.publish(self._node, PIPELINE_TOPIC, state)

    def contacts_of(self, details: Mapping[str, Any]) -> None:
        """Show what touches, by the details of a failure; nothing changes when that was not why."""
        pairs = details.get("pairs")
        if pairs:
            self.contacts(pairs)

    def contacts(self, pairs: Sequence[Mapping[str, Any]]) -> None:
        """Show where things touch; those shown before go.

        Args:
            pairs: as planners tell them in the details of a failure: ``first``, ``second``, ``depth_m``, ``point_m``.
        """
        header = {"stamp": Stamp(0, 0).as_message(), "frame_id": self._robot.root_link}
        clear = {"header": header, "ns": "", "action": DELETE_ALL}
        markers = [_marker(header, index, pair) for index, pair in enumerate(pairs)]
        self._graph.publish(self._node, CONTACTS_TOPIC, {"markers": [clear, *markers]})


def _marker(header: Mapping[str, Any], index: int, pair: Mapping[str, Any]) -> dict[str, Any]:
    """A ball where two things touch; the namespace names them."""
    position = dict(zip("xyz", pair["point_m"], strict=True))
    return {
        "header": header,
        "ns": f"{pair['first']}, {pair['second']}",
        "id": index,
        "type": SPHERE,
        "action": ADD,
        "pose": {"position": position},
        "scale": dict.fromkeys("xyz", CONTACT_DIAMETER_M),
        "color": CONTACT_COLOR,
        "lifetime": {"sec": CONTACT_LIFETIME_S, "nanosec": 0},
    }
