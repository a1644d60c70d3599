"""Bridge between actions and the goal queue: goals in, the queue's answers back as results."""

import asyncio
import functools
import logging
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

from planners.problem import MoveItErrorCode, PlanningFailure
from server.errors import ServerError
from server.execution.goal import Answer, Goal, GoalPolicy, GoalRequest, Progress
from server.execution.motions import Motion
from server.execution.queue import GoalQueue
from server.graph.actions import ActionGoal, GoalStatus
from server.moveit.messages import Message

log = logging.getLogger("armbridge.actions")


def work_on(goal: ActionGoal, work: Coroutine[Any, Any, None]) -> None:
    """Work on a goal in a task; where the work fails, the goal ends with the reason."""

    async def run() -> None:
        try:
            await work
        except ServerError as error:
            log.warning("%s: %s", goal.action, error)
            goal.fail(str(error))
        except Exception as error:  # a bug must cost this goal only, and never its result
            log.exception("a goal of %s failed", goal.action)
            goal.fail(f"internal error: {type(error).__name__}: {error}")

    task = asyncio.create_task(run(), name=goal.action)
    # The goal keeps the task alive, which the event loop does not.
    goal.when_ended(lambda _end: task)


def submit_goal(
    goal: ActionGoal,
    queue: GoalQueue,
    motion: Motion,
    on_progress: Callable[[Progress], None],
    on_answer: Callable[[Answer], None],
) -> Goal:
    """Submit the motion of a goal, in place of the present motion of the arm's group."""
    request = GoalRequest(
        goal.action, motion, client=goal.sender, policy=GoalPolicy.PREEMPT, on_progress=on_progress, on_answer=on_answer
    )
    queued = queue.submit(request)
    cancel_with_goal(goal, functools.partial(queue.cancel, queued.goal_id))
    return queued


def plan_without_moving(
    work: Coroutine[Any, Any, Answer], name: str, end: Callable[[Answer], object]
) -> Callable[[str], object]:
    """Call ``end`` with the answer of some planning; return the function that cancels it, and keeps its task alive."""

    def take(done: asyncio.Task[Answer]) -> None:
        if done.cancelled():
            answer = Answer(MoveItErrorCode.PREEMPTED, "cancelled while planning")
        elif (error := done.exception()) is not None:
            log.error("planning for an action failed", exc_info=error)
            answer = Answer(MoveItErrorCode.FAILURE, f"internal error: {type(error).__name__}: {error}")
        else:
            answer = done.result()
            if answer.code is MoveItErrorCode.SUCCESS:
                sentences = filter(None, (answer.performed.summary, answer.message))
                answer = replace(answer, message="; ".join(sentences))
            else:
                log.warning("a plan was asked for: %s: %s", answer.code.name, answer.message)
        end(answer)

    task = asyncio.create_task(work, name=f"plan for {name}")
    task.add_done_callback(take)
    return lambda _reason: task.cancel()


def cancel_with_goal(goal: ActionGoal, cancel: Callable[[str], object]) -> None:
    """Cancel the work for a goal when a client asks for it, and when the goal ends in any other way.

    A goal may end before its motion: its time is over, or a part of the server has failed.
    """

    def cancelled() -> None:
        cancel(f"cancelled by a client of {goal.action}")

    goal.when_canceled(cancelled)
    goal.when_ended(lambda end: cancel(f"the goal of {goal.action} is over" + ("" if end.ok else f": {end.values}")))


def reject_goal(
    goal: ActionGoal, queue: GoalQueue, failure: PlanningFailure, result: Callable[[Answer], Message]
) -> None:
    """End a goal that cannot be submitted; the arm's motion continues."""
    queue.reject(GoalRequest(goal.action), failure)
    finish_goal(goal, Answer.of(failure), result)


def finish_goal(goal: ActionGoal, answer: Answer, result: Callable[[Answer], Message]) -> None:
    goal.finish(goal_status(answer.code), result(answer))


def goal_status(code: MoveItErrorCode) -> GoalStatus:
    if code is MoveItErrorCode.SUCCESS:
        return GoalStatus.SUCCEEDED
    return GoalStatus.CANCELED if code is MoveItErrorCode.PREEMPTED else GoalStatus.ABORTED
