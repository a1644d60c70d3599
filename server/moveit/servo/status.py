"""``/servo_node/status``: what holds the arm back while it is steered, in words, and in numbers of both generations."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from planners.servo.question import ServoStatus
from server.graph.node import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.servo")

# A client goes on asking for what it was refused.
LOGGED_AGAIN_S = 5.0

STATUS_TOPIC = "/servo_node/status"

INT8 = "std_msgs/Int8"

# moveit_servo/status_codes.h of humble; the others have the same numbers.
HUMBLE_NUMBERS = {
    ServoStatus.DECELERATE_FOR_COLLISION: 3,
    ServoStatus.HALT_FOR_COLLISION: 4,
    ServoStatus.JOINT_BOUND: 5,
    ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY: 6,
}


class StatusTopic:
    """Publishes the status: every step of the steering, and every refusal.

    Args:
        graph: where the topic is.
        node: who publishes.
        type_name: ``moveit_msgs/ServoStatus`` or ``std_msgs/Int8``.
        clock: monotonic time [s].
    """

    def __init__(self, graph: Graph, node: Node, type_name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._graph = graph
        self._node = node
        self._type_name = type_name
        self._clock = clock
        self._logged, self._logged_at_s = "", 0.0

    def open(self) -> None:
        """Advertise."""
        self._graph.advertise(self._node, STATUS_TOPIC, self._type_name, latch=True)

    def tell(self, status: ServoStatus, message: str) -> None:
        """Publish; what was refused is logged as well, but not a hundred times a second."""
        if status is ServoStatus.INVALID:
            self._log(message)
        if self._type_name == INT8:
            told: dict[str, object] = {"data": HUMBLE_NUMBERS.get(status, int(status))}
        else:
            told = {"code": int(status), "message": message}
        self._graph.publish(self._node, STATUS_TOPIC, told)

    def _log(self, message: str) -> None:
        now_s = self._clock()
        if message != self._logged or now_s - self._logged_at_s > LOGGED_AGAIN_S:
            self._logged, self._logged_at_s = message, now_s
            log.warning("servo: %s", message)
