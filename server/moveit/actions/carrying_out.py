"""From an action's goal to the queue before the arm and back: what all actions that move the arm have in common."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from server.execution.motions import Motion
from server.execution.queue import Answer, GoalPolicy, GoalQueue, GoalState, Progress
from server.graph.actions import Goal, GoalStatus

log = logging.getLogger("armbridge.actions")

Message: TypeAlias = Mapping[str, Any]

# What MoveIt's actions call their states (move_group's MoveGroupState); a goal that waits has none yet.
MOVEIT_STATES = {
    GoalState.PLANNING: "PLANNING",
    GoalState.EXECUTING: "MONITOR",
    GoalState.DONE: "IDLE",
}


def carry_out(
    goal: Goal,
    queue: GoalQueue[Motion],
    request: Motion,
    feedback: Callable[[Progress], Message | None],
    result: Callable[[Answer], Message],
) -> None:
    """Have a goal of an action carried out, in place of whatever moves the arm's group now.

    Args:
        goal: the goal; it ends with the answer.
        queue: the one way to the arm.
        request: what the goal asks for.
        feedback: the feedback message for some news, None for none.
        result: the result message for the answer.
    """

    def tell(progress: Progress) -> None:
        message = feedback(progress)
        if message is not None:
            goal.feedback(message)

    def end(answer: Answer) -> None:
        tell(Progress(GoalState.DONE, answer.message))
        finish(goal, answer, result)

    number = queue.submit(goal.action, request, policy=GoalPolicy.PREEMPT, on_progress=tell, on_answer=end)
    goal.when_canceled(lambda: queue.cancel(number, f"cancelled by a client of {goal.action}"))


def refuse(
    goal: Goal,
    queue: GoalQueue[Motion],
    failure: PlanningFailure,
    result: Callable[[Answer], Message],
) -> None:
    """Answer a goal that cannot be asked for; what moves goes on."""
    queue.reject(goal.action, failure)
    finish(goal, Answer.of(failure), result)


def finish(goal: Goal, answer: Answer, result: Callable[[Answer], Message]) -> None:
    """End a goal with its result."""
    goal.finish(status_of(answer.code), result(answer))


def status_of(code: MoveItErrorCode) -> GoalStatus:
    """How the end is called in action_msgs/GoalStatus."""
    if code is MoveItErrorCode.SUCCESS:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is MoveItErrorCode.PREEMPTED else GoalStatus.ABORTED


class StateFeedback:
    """MoveIt's feedback: the name of the state, whenever it is another."""

    def __init__(self) -> None:
        self._last = ""

    def __call__(self, progress: Progress) -> Message | None:
        """The feedback message for some news."""
        state = MOVEIT_STATES.get(progress.state, "")
        if state in ("", self._last):
            return None
        self._last = state
        return {"state": state}
