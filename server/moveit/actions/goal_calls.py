"""Goals of clients that know only services or actions: ``/moveit_goal``, one request in and one answer out.

A request has one goal of those that ``/moveit_goal_*`` take, and goes their way: the same translation, queue,
confirmation and status. The answer comes at the end of the motion.
"""

import functools
import logging
from dataclasses import replace

from planners.problem import MoveItErrorCode
from server.diagnostic_values import key_values
from server.errors import RefusedError, invalid, refused
from server.execution.goal import Answer, GoalPolicy, GoalRequest, GoalState, Progress
from server.execution.queue import GoalQueue
from server.graph.actions import ActionGoal, Result
from server.graph.permissions import CALLED_GOAL
from server.graph.providers import CompleteResponse
from server.graph.services import MAX_TIMEOUT_S, Call, Response
from server.graph.topics import LocalGraph
from server.moveit.actions.goal_bridge import cancel_with_goal, goal_status, plan_without_moving
from server.moveit.actions.move_group import plan_steps
from server.moveit.goals.goal_topics import (
    GOAL_LIMITS,
    JOINTS_TOPIC,
    NAMED_TOPIC,
    POSE_TOPIC,
    TARGET_FIELDS,
    GoalTranslator,
    details_as_json,
    suggestion,
)
from server.moveit.messages import Message
from server.moveit.scene.interface import NO_STATE

log = logging.getLogger("armbridge.goals")

# Name of the service and of the action.
NAME = "/moveit_goal"
SERVICE_TYPE, ACTION_TYPE = "armbridge_msgs/srv/MoveitGoal", "armbridge_msgs/action/MoveitGoal"


class GoalCalls:
    """The service and the action ``/moveit_goal``."""

    def __init__(self, graph: LocalGraph, queue: GoalQueue, translator: GoalTranslator) -> None:
        self._queue = queue
        self._translator = translator
        self._context = translator.planning
        self._actions = graph.graph.actions
        node = graph.node("moveit goal")
        self._name = node.resolve(NAME)
        node.offer_calls(NAME, SERVICE_TYPE, self._call, MAX_TIMEOUT_S, GOAL_LIMITS, rule=CALLED_GOAL)
        node.offer_action(NAME, ACTION_TYPE, self._start, GOAL_LIMITS, rule=CALLED_GOAL)

    def _call(self, call: Call) -> None:
        """Send a goal of the action for a call, which is answered by its result."""

        def ended(response: Response) -> None:
            """Cancel the goal of a call without its answer; as others, it outlives its client's leaving."""
            if goal is not None and not response.ok and (call.request["plan_only"] or not call.caller_left):
                goal.cancel()

        def take(result: Result) -> None:
            if result.ok:
                # The response has the fields of the result.
                call.succeed(CompleteResponse(result.values))
            else:
                call.fail(result.values)

        goal = self._actions.send_goal(call.caller, self._name, ACTION_TYPE, call.request, take)
        call.when_ended(ended)

    def _start(self, goal: ActionGoal) -> None:
        request, client = goal.request, goal.sender
        message: Message = {}
        proposed = client.is_viewer and not request["plan_only"]
        try:
            if proposed and (first := self._context.confirmation.proposal) is not None:
                state = "is carried out" if first.remaining_s is not None else "waits for approval"
                sentence = (
                    f"{first.title} {state}; one proposed goal is taken at a time: wait for its answer, or cancel it"
                )
                raise refused(MoveItErrorCode.CONTROL_FAILED, sentence)
            topic, message = _goal_of(request)
            motion = self._translator.motion(topic, message, self._translator.options(request))
        except RefusedError as error:
            rejected = self._queue.reject(GoalRequest(self._name, message=message), error.failure)
            self._end(goal, message, Answer.of(error.failure), rejected.goal_id)
            return
        for warning in motion.warnings:
            log.warning("%s: %s", self._name, warning)
        report = functools.partial(_report, goal)
        if request["plan_only"]:
            report(Progress(GoalState.PLANNING, "planning"))
            # Planned from where the arm is, whatever it does meanwhile.
            work = plan_steps(motion.steps, NO_STATE, client, self._context)
            end = functools.partial(self._end, goal, message)
            cancel_with_goal(goal, plan_without_moving(work, self._name, end))
            return
        motion = replace(motion, confirm=proposed or self._context.confirmation.enabled, proposed=proposed)
        # A proposal neither preempts a motion nor is refused for one.
        policy = GoalPolicy.QUEUE if proposed else None
        queued = self._queue.submit(GoalRequest(self._name, motion, message, client, policy=policy, on_progress=report))
        if proposed:
            self._context.confirmation.propose(queued)
        queued.answered.add_done_callback(lambda answered: self._end(goal, message, answered.result(), queued.goal_id))
        cancel_with_goal(goal, functools.partial(self._queue.cancel, queued.goal_id))

    def _end(self, goal: ActionGoal, message: Message, answer: Answer, number: str = "") -> None:
        instead = suggestion(message, answer.details, self._context.robot)
        sentence = answer.message if instead is None else instead.added_to(answer.message)
        succeeded = answer.code is MoveItErrorCode.SUCCESS
        _report(goal, Progress(GoalState.DONE, sentence, 1.0 if succeeded else 0.0))
        result = {
            "success": succeeded,
            "code": int(answer.code),
            "code_name": answer.code.name,
            "message": sentence,
            "goal_id": number,
            "duration_s": answer.performed.duration_s,
            "suggested": {} if instead is None else instead.as_target(),
            "details": key_values(details_as_json(answer)),
        }
        goal.finish(goal_status(answer.code), result)


def _report(goal: ActionGoal, progress: Progress) -> None:
    state, left_s = progress.state.value, progress.remaining_s
    goal.feedback({"state": state, "message": progress.message, "fraction": progress.fraction, "seconds_left": left_s})


def _goal_of(request: Message) -> tuple[str, Message]:
    """Return the one goal of a request: a topic, and its message."""
    given: dict[str, Message] = {}
    if request["named"]:
        given[NAMED_TOPIC] = {"data": request["named"]}
    if request["joints"]["name"] or request["joints"]["position"]:
        given[JOINTS_TOPIC] = request["joints"]
    if _is_given(request["pose"]):
        given[POSE_TOPIC] = request["pose"]
    if len(given) != 1:
        got = " and ".join(TARGET_FIELDS[topic] for topic in given) or "none"
        raise invalid(f"exactly one of the fields named, joints and pose must be given, not {got}")
    return next(iter(given.items()))


def _is_given(pose: Message) -> bool:
    """Return True for a geometry_msgs/PoseStamped with a frame, a place or a turn."""
    place, turn = pose["pose"]["position"], pose["pose"]["orientation"]
    turned = any(turn[axis] for axis in "xyz") or turn["w"] not in (0.0, 1.0)
    return bool(pose["header"]["frame_id"]) or turned or any(place[axis] for axis in "xyz")
