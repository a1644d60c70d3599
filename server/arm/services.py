"""The services under ``/arm/``, and the topic ``/emergency_stop``: what a person asks of the arm besides motions.

Speed, pause and the way back while the arm moves: the topic ``/arm/speed_factor`` and three services.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from robot.arm import Arm
from robot.messages import ChangePace, CommandDone, Course, Mode, Order
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber

log = logging.getLogger("armbridge.arm")

ENABLE = "/arm/enable"
RELAX = "/arm/relax"
STOP = "/arm/stop"
EMERGENCY_STOP = "/arm/emergency_stop"
RESET_FAULT = "/arm/reset_fault"
EMERGENCY_STOP_TOPIC = "/emergency_stop"

# Braking takes a second at most.
STOP_TIMEOUT_S = 2.0

Response = dict[str, Any]


class ArmServices:
    """Offers the services and listens to the topic.

    Orders leave for the arm process before anything else happens: no queue, no task and no waiting in between.

    Args:
        graph: where they are.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._node = Node("arm services")

    def open(self, arm: Arm, end_goals: Callable[[str], None]) -> None:
        """Offer and subscribe.

        Args:
            arm: who obeys.
            end_goals: ends the goal in hand and all that wait, and stops every motion, for a reason.
        """

        def emergency_stop(name: str) -> asyncio.Future[CommandDone]:
            answered = arm.order(Order.EMERGENCY_STOP)
            log.warning("emergency stop by %s", name)
            end_goals(f"emergency stop by {name}")
            return answered

        def relax() -> Awaitable[CommandDone]:
            end_goals(f"relaxed by {RELAX}")
            return arm.order(Order.RELAX)

        def stop() -> Awaitable[CommandDone]:
            end_goals(f"stopped by {STOP}")
            return _standstill(arm)

        self._offer(ENABLE, lambda: arm.order(Order.ENABLE))
        self._offer(RELAX, relax)
        self._offer(STOP, stop)
        self._offer(EMERGENCY_STOP, lambda: emergency_stop(EMERGENCY_STOP))
        self._offer(RESET_FAULT, lambda: arm.order(Order.RESET_FAULT))
        # Whoever writes to this topic wants the arm to stop, whatever the message looks like.
        stopper = Subscriber(
            lambda _published: _log_end(emergency_stop(EMERGENCY_STOP_TOPIC)),
            lambda _error: _log_end(emergency_stop(EMERGENCY_STOP_TOPIC)),
        )
        self._graph.subscribe(self._node, EMERGENCY_STOP_TOPIC, "std_msgs/Empty", stopper)

    def _offer(self, name: str, act: Callable[[], Awaitable[CommandDone]]) -> None:
        def serve(_request: Response) -> Awaitable[Response]:
            return _response(act())

        self._graph.services.offer(self._node, name, "std_srvs/Trigger", serve)


async def _response(answered: Awaitable[CommandDone]) -> Response:
    """The std_srvs/Trigger response of an order's answer."""
    done = await answered
    return {"success": done.done, "message": done.message}


async def _standstill(arm: Arm) -> CommandDone:
    """Wait until the arm no longer moves."""
    if await arm.rest(STOP_TIMEOUT_S):
        return CommandDone(0, done=True, message="the arm does not move")
    return CommandDone(0, done=False, message=f"the arm still moves after {STOP_TIMEOUT_S:g} s")


def _log_end(answered: asyncio.Future[CommandDone]) -> None:
    """Tell the log how an emergency stop went that nobody waits for."""

    def tell(future: asyncio.Future[CommandDone]) -> None:
        if not future.cancelled():
            done = future.result()
            log.log(logging.WARNING if done.done else logging.ERROR, "emergency stop: %s", done.message)

    answered.add_done_callback(tell)


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
            lambda published: _set_speed(arm, published.msg["data"]),
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
