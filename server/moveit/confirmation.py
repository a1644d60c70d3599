"""Confirm mode: a goal is planned and shown, and the arm moves when somebody says so."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from planners.problem import MoveItErrorCode
from server.goal_queue import Answer
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber

log = logging.getLogger("armbridge.goals")

CONFIRM_TOPIC = "/moveit_goal_confirm"
MODE_SERVICE = "/moveit_goal_confirm_mode"


class Confirmation:
    """The gate between plan and motion.

    Args:
        graph: where topic and service are.
        wanted: whether goals of the simple layer wait at the gate.
        timeout_s: how long they wait there [s].

    Attributes:
        wanted: as given; the service changes it for goals to come.
    """

    def __init__(self, graph: Graph, *, wanted: bool, timeout_s: float) -> None:
        self._graph = graph
        self._node = Node("confirmation")
        self._word: asyncio.Future[bool] | None = None
        self._timeout_s = timeout_s
        self.wanted = wanted

    def open(self) -> None:
        """Subscribe and offer."""
        subscriber = Subscriber(
            lambda publication: self._hear(go=publication.msg["data"]),
            lambda error: log.warning("%s: %s", CONFIRM_TOPIC, error),
        )
        self._graph.subscribe(self._node, CONFIRM_TOPIC, "std_msgs/Bool", subscriber)
        self._graph.services.offer(self._node, MODE_SERVICE, "std_srvs/SetBool", self._set_mode)

    async def ask(self) -> Answer | None:
        """Wait for the word: None to go on, else the goal's answer."""
        self._word = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(self._timeout_s):
                go = await self._word
        except TimeoutError:
            message = f"planned, but not confirmed on {CONFIRM_TOPIC} within {self._timeout_s:g} s"
            return Answer(MoveItErrorCode.TIMED_OUT, message)
        finally:
            self._word = None
        return None if go else Answer(MoveItErrorCode.PREEMPTED, f"planned, and discarded by {CONFIRM_TOPIC}")

    def _hear(self, *, go: bool) -> None:
        if self._word is None or self._word.done():
            log.warning("%s: ignored, no goal waits for it", CONFIRM_TOPIC)
        else:
            self._word.set_result(go)

    def _set_mode(self, request: dict[str, Any]) -> dict[str, Any]:
        self.wanted = request["data"]
        said = f"wait for a message on {CONFIRM_TOPIC}" if self.wanted else "are carried out at once"
        return {"success": True, "message": f"goals on /moveit_goal_* {said}"}
