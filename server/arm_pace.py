"""Speed, pause and the way back while the arm moves: the topic ``/arm/speed_factor`` and three services."""

from __future__ import annotations

import logging
from typing import Any

from robot.arm import Arm
from robot.messages import ChangePace, Course, Mode
from server.graph_topics import Graph, Subscriber
from server.node import Node

log = logging.getLogger("armbridge.arm")

SPEED_FACTOR_TOPIC = "/arm/speed_factor"
PAUSE = "/arm/pause"
RESUME = "/arm/resume"
STEP_BACK = "/arm/step_back"

_SENTENCES = {
    Course.PAUSED: f"the arm comes to rest on its path; {RESUME} lets it go on",
    Course.FORWARD: "the arm goes on",
    Course.BACK: f"the arm goes back along its path until {PAUSE} or {RESUME}, at most to where it came from",
}


class ArmPace:
    """Lets people say how motions are played. The guards and limits of the arm hold at every pace.

    Args:
        graph: where the topic and the services are.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._node = Node("arm pace")

    def open(self, arm: Arm) -> None:
        """Subscribe and offer.

        Args:
            arm: who obeys.
        """
        subscriber = Subscriber(
            lambda publication: _set_speed(arm, publication.msg["data"]),
            lambda error: log.warning("%s: %s", SPEED_FACTOR_TOPIC, error),
        )
        self._graph.subscribe(self._node, SPEED_FACTOR_TOPIC, "std_msgs/Float64", subscriber)
        for name, course in ((PAUSE, Course.PAUSED), (RESUME, Course.FORWARD), (STEP_BACK, Course.BACK)):
            self._offer(arm, name, course)

    def _offer(self, arm: Arm, name: str, course: Course) -> None:
        def serve(_request: dict[str, Any]) -> dict[str, Any]:
            if arm.state.mode is not Mode.MOVING:
                return {"success": False, "message": f"no motion is in progress: the arm is {arm.state.mode.value}"}
            arm.change_pace(ChangePace(course=course))
            return {"success": True, "message": _SENTENCES[course]}

        self._graph.services.offer(self._node, name, "std_srvs/Trigger", serve)


def _set_speed(arm: Arm, factor: float) -> None:
    if 0.0 <= factor <= 1.0:
        arm.change_pace(ChangePace(speed_factor=factor))
    else:
        log.warning("%s: data must be 0 to 1, a share of the planned speed, not %s", SPEED_FACTOR_TOPIC, factor)
