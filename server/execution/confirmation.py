"""Confirmation of plans by users: the arm moves when somebody has seen the plan."""

import asyncio
import logging
from typing import Any

from planners.problem import MoveItErrorCode
from protocol.errors import shorten
from protocol.publication import PublishedMessage
from server.diagnostic_values import LEVEL_OK, diagnostic_status
from server.execution.goal import Answer, Goal, GoalState, Progress
from server.execution.motions import Performed, PlannedMotion
from server.graph.permissions import CONFIGURING, WORKING
from server.graph.topics import Graph

log = logging.getLogger("armbridge.goals")

APPROVE_TOPIC = "/moveit_goal_approve"
APPROVAL_TOPIC = "/moveit_goal_approval"
CONFIRM_MODE_SERVICE = "/moveit_goal_confirm_mode"

NOTHING_WAITS = diagnostic_status(LEVEL_OK, "", "no goal waits", {})


class Confirmation:
    """Gate between plan and motion: the arm moves when a user confirms the plan.

    A plan is confirmed by its goal's id, so that a user who decides on one plan cannot confirm the next one, which has
    just taken its place.
    """

    def __init__(self, graph: Graph, *, enabled: bool, timeout_s: float) -> None:
        self._node = graph.node("confirmation")
        # The proposed goal that is not answered yet; None without one. There is one at a time.
        self.proposal: Goal | None = None
        self._waiting: Goal | None = None
        self._confirmed = asyncio.Event()
        # Goals of several groups are confirmed one after the other.
        self._turn = asyncio.Lock()
        self._timeout_s = timeout_s
        self.enabled = enabled  # True while all goals wait for a confirmation
        # Another client may confirm than the driving one.
        self._node.subscribe(APPROVE_TOPIC, "std_msgs/String", self._confirm, rule=WORKING)
        self._node.advertise(APPROVAL_TOPIC, "diagnostic_msgs/DiagnosticStatus", latch=True)
        self._node.publish(APPROVAL_TOPIC, NOTHING_WAITS)
        self._node.offer(CONFIRM_MODE_SERVICE, "std_srvs/SetBool", self._set_mode, rule=CONFIGURING)

    def propose(self, goal: Goal) -> None:
        """Take a goal as the proposal until it is answered."""
        self.proposal = goal

        def forget(_answered: object) -> None:
            self.proposal = None

        goal.answered.add_done_callback(forget)

    async def wait(self, goal: Goal, planned: Performed) -> Answer | None:
        """Wait until a plan is confirmed; return None to go on, else the goal's answer."""
        async with self._turn:
            self._waiting = goal
            self._confirmed.clear()
            self._publish_request(goal, planned)
            # Last: a client that learns of the waiting plan may decide on it at once.
            waits = f"{goal.request.client} asks for your approval" if _is_proposed(goal) else "waits to be confirmed"
            goal.report(Progress(GoalState.PLANNED, f"{planned.summary}; {waits}", 0.0, planned.duration_s))
            try:
                async with asyncio.timeout(self._timeout_s):
                    await self._confirmed.wait()
            except TimeoutError:
                message = f"planned, but not confirmed on {APPROVE_TOPIC} within {self._timeout_s:g} s"
                return Answer(MoveItErrorCode.TIMED_OUT, message)
            finally:
                self._waiting = None
                self._node.publish(APPROVAL_TOPIC, NOTHING_WAITS)
            return None

    def _confirm(self, published: PublishedMessage) -> None:
        goal_id = published.msg["data"]
        if self._waiting is None:
            log.warning("%s: ignored, no goal waits for it", APPROVE_TOPIC)
        elif goal_id != self._waiting.goal_id:
            log.warning("%s: ignored, goal %s waits, not %r", APPROVE_TOPIC, self._waiting.goal_id, shorten(goal_id))
        else:
            self._confirmed.set()

    def _publish_request(self, goal: Goal, planned: Performed) -> None:
        values = {
            "client": str(goal.request.client),
            "proposed": str(_is_proposed(goal)).lower(),
            "summary": planned.summary,
            "duration_s": f"{planned.duration_s:.2f}",
            "timeout_s": f"{self._timeout_s:g}",
        }
        message = f"{goal.title} waits: {planned.summary}"
        self._node.publish(
            APPROVAL_TOPIC, diagnostic_status(LEVEL_OK, goal.request.source, message, values, goal.goal_id)
        )

    def _set_mode(self, request: dict[str, Any]) -> str:
        self.enabled = request["data"]
        said = f"wait for their id on {APPROVE_TOPIC}" if self.enabled else "are carried out at once"
        return f"goals on /moveit_goal_* {said}"


def _is_proposed(goal: Goal) -> bool:
    return isinstance(goal.request.motion, PlannedMotion) and goal.request.motion.proposed
