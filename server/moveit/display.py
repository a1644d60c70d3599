"""Topics for viewers: the arm's transforms, planned motions, contacts, and the state of the pipeline."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from protocol.messages import Stamp
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.messages import ArmState
from server.execution.monitors import state_message
from server.execution.motions import Performed
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.poses import Message, pose_of, write_transform
from server.moveit.trajectories import to_message

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

# More of them hide the arm.
MAX_CONTACTS = 50

TRANSFORMS_TOPIC = "/tf"
STATIC_TRANSFORMS_TOPIC = "/tf_static"

# A state that is due a little early still counts.
EARLY_S = 0.005


class DisplayTopics:
    """Topics of planned motions, contacts and the pipeline's state."""

    def __init__(self, graph: Graph, robot: RobotModel) -> None:
        self._graph = graph
        self._robot = robot
        self._node = Node("display")
        self._graph.advertise(self._node, PATH_TOPIC, "moveit_msgs/DisplayTrajectory", latch=True)
        self._graph.advertise(self._node, CONTACTS_TOPIC, "visualization_msgs/MarkerArray")
        self._graph.advertise(self._node, PIPELINE_TOPIC, "moveit_msgs/PipelineState")

    def performed(self, performed: Performed) -> None:
        """Show motions that are about to be executed, one after the other."""
        root = self._robot.root_link
        start = state_message(dict(performed.start_rad), root, 0.0)
        self.trajectories([to_message(motion, root) for motion in performed.planned], start)

    def trajectories(self, trajectories: Sequence[Message], start: Message) -> None:
        """Show planned motions, one after the other, that are written already."""
        message = {"model_id": self._robot.name, "trajectory": list(trajectories), "trajectory_start": start}
        self._graph.publish(self._node, PATH_TOPIC, message, prevalidated=True)

    def pipeline(self, request: Message, response: Message) -> None:
        """Publish a request to the planners and its response, if there are subscribers."""
        if self._graph.subscribers(PIPELINE_TOPIC):
            state = {"request": request, "response": response, "pipeline_stage": PIPELINE_STAGE}
            self._graph.publish(self._node, PIPELINE_TOPIC, state)

    def contacts_of(self, details: Mapping[str, Any]) -> None:
        """Show the contacts in the details of a failure; do nothing when there are none."""
        if details.get("pairs"):
            self.contacts(details["pairs"])

    def contacts(self, pairs: Sequence[Mapping[str, Any]]) -> None:
        """Show contacts in place of the contacts before, `MAX_CONTACTS` of them.

        Args:
            pairs: each with ``first``, ``second``, ``depth_m``, ``point_m``.
        """
        header = {"stamp": Stamp(0, 0).as_message(), "frame_id": self._robot.root_link}
        clear = {"header": header, "ns": "", "action": DELETE_ALL}
        markers = [_marker(header, index, pair) for index, pair in enumerate(pairs[:MAX_CONTACTS])]
        self._graph.publish(self._node, CONTACTS_TOPIC, {"markers": [clear, *markers]})


def _marker(header: Mapping[str, Any], index: int, pair: Mapping[str, Any]) -> dict[str, Any]:
    """Return a sphere at a contact; its namespace names the two bodies."""
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


class TransformsTopics:
    """Transforms of the arm: transforms of movable joints with the joint states, the others once."""

    def __init__(self, graph: Graph, robot: RobotModel, rate_hz: float) -> None:
        self._graph = graph
        self._period_s = 1.0 / rate_hz
        self._placements = ForwardPlacements(robot)
        joints = robot.joints.values()
        self._moving = [joint.child for joint in joints if joint.moves]
        self._fixed = [joint.child for joint in joints if not joint.moves]
        self._node = Node("robot state publisher")
        self._published_s = 0.0
        self._graph.advertise(self._node, TRANSFORMS_TOPIC, "tf2_msgs/TFMessage")
        self._graph.advertise(self._node, STATIC_TRANSFORMS_TOPIC, "tf2_msgs/TFMessage", latch=True)
        self._graph.publish(self._node, STATIC_TRANSFORMS_TOPIC, self._message(self._fixed, {}, time.time()))

    def take_state(self, state: ArmState) -> None:
        """Publish a state of the arm, if there are subscribers and it is due."""
        if state.position_rad is None or not self._graph.subscribers(TRANSFORMS_TOPIC):
            return
        # The clock of a process that has started again may be behind; that must not silence the topic.
        if 0.0 <= state.clock_s - self._published_s < self._period_s - EARLY_S:
            return
        self._published_s = state.clock_s
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
                    "transform": write_transform(pose_of(transform_link_to_parent)),
                }
            )
        return {"transforms": transforms}
