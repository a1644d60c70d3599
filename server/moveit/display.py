"""Topics for viewers: planned motions, contacts, and the state of the pipeline."""

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from protocol.messages import Stamp
from robot.description.model import RobotModel
from server.execution.monitors import state_message
from server.execution.motions import Performed
from server.graph.topics import Graph
from server.moveit.messages import Message
from server.moveit.trajectories import is_long, to_message, to_messages

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


class DisplayTopics:
    """Topics of planned motions, contacts and the pipeline's state."""

    def __init__(self, graph: Graph, robot: RobotModel) -> None:
        self._robot = robot
        self._node = graph.node("display")
        # A long motion that is still to be shown, unless another comes first.
        self._writing: asyncio.Task[None] | None = None
        self._node.advertise(PATH_TOPIC, "moveit_msgs/DisplayTrajectory", latch=True)
        self._node.advertise(CONTACTS_TOPIC, "visualization_msgs/MarkerArray")
        self._node.advertise(PIPELINE_TOPIC, "moveit_msgs/PipelineState")

    def performed(self, performed: Performed) -> None:
        """Show planned motions, one after the other."""
        if self._writing is not None:
            self._writing.cancel()
        if is_long(performed.planned):
            self._writing = asyncio.create_task(self._show_long(performed), name="shown motion")
        else:
            self._publish(performed, [to_message(motion, self._robot.root_link) for motion in performed.planned])

    async def _show_long(self, performed: Performed) -> None:
        self._publish(performed, await to_messages(performed.planned, self._robot.root_link))

    def _publish(self, performed: Performed, trajectories: list[Message]) -> None:
        start = state_message(performed.start_rad, self._robot.root_link, 0.0)
        message = {"model_id": self._robot.name, "trajectory": trajectories, "trajectory_start": start}
        self._node.publish(PATH_TOPIC, message, prevalidated=True)

    def pipeline(self, request: Message, response: Message) -> None:
        """Publish a request to the planners and its response, if there are subscribers."""
        if self._node.subscribers(PIPELINE_TOPIC):
            state = {"request": request, "response": response, "pipeline_stage": PIPELINE_STAGE}
            self._node.publish(PIPELINE_TOPIC, state)

    def contacts_of(self, details: Mapping[str, Any]) -> None:
        """Show the contacts in the details of a failure; do nothing when there are none."""
        if details.get("pairs"):
            self.contacts(details["pairs"])

    def contacts(self, pairs: Sequence[Mapping[str, Any]]) -> None:
        """Show contacts in place of the contacts before: pairs with ``first``, ``second``, ``depth_m``, ``point_m``."""
        header = {"stamp": Stamp(0, 0).as_message(), "frame_id": self._robot.root_link}
        clear = {"header": header, "ns": "", "action": DELETE_ALL}
        markers = [_marker(header, index, pair) for index, pair in enumerate(pairs[:MAX_CONTACTS])]
        self._node.publish(CONTACTS_TOPIC, {"markers": [clear, *markers]})


def _marker(header: Mapping[str, Any], index: int, pair: Mapping[str, Any]) -> dict[str, Any]:
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
