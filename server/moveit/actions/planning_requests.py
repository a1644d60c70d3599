"""What goals that are planned ask for: their requests, read against the arm as it is when their turn comes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Scene
from server.errors import RefusedError
from server.execution.motions import PlannedMotion, Positions, plan_sequence
from server.execution.queue import Answer
from server.graph.actions import Goal
from server.moveit.actions.carrying_out import Message
from server.moveit.actions.planning_options import Options, options_of
from server.moveit.requests.robot_state import attached_diff
from server.moveit.services.planning_context import PlanningContext, Situation


@dataclass(frozen=True)
class Asked:
    """What a goal asks for.

    Attributes:
        requests: moveit_msgs/MotionPlanRequest, the first to be carried out first.
        options: the rest.
    """

    requests: Sequence[Message]
    options: Options


Requests = Callable[[Message], Sequence[Message] | PlanningFailure]


def asked_by(goal: Goal, requests_of: Requests) -> Asked | PlanningFailure:
    """Read a goal.

    Args:
        goal: of an action whose goals have planning options.
        requests_of: finds the requests in its message.
    """
    options = options_of(goal.request["planning_options"])
    requests = requests_of(goal.request)
    if isinstance(options, PlanningFailure):
        return options
    return requests if isinstance(requests, PlanningFailure) else Asked(requests, options)


def motion_of(asked: Asked, context: PlanningContext) -> PlannedMotion | PlanningFailure:
    """The motion to plan and carry out; what cannot be asked for is refused before it takes any motion's place.

    Args:
        asked: what the goal asks for.
        context: what it is read against.
    """
    options, present_rad = asked.options, context.current.positions_rad()
    warnings = [*options.warnings, *_start_ignored(asked.requests)]
    if present_rad is not None:
        refusal = _refusal(asked.requests, present_rad, context, warnings)
        if refusal is not None:
            return refusal
    return PlannedMotion(
        steps=tuple(context.step(request) for request in asked.requests),
        scene=_scene_of(options.scene_diff, context),
        attempts=options.attempts,
        delay_s=options.delay_s,
        warnings=tuple(warnings),
    )


async def planned_only(goal: Goal, asked: Asked, context: PlanningContext) -> Answer:
    """Plan from the start that the first request names, whatever the arm does meanwhile.

    Args:
        goal: the goal; what its sender wants the state to be counts where the request says nothing.
        asked: what it asks for.
        context: what it is read against and planned with.
    """
    state, options = asked.requests[0]["start_state"], asked.options
    try:
        situation = context.situation(state, goal.sender)
    except RefusedError as refused:
        return Answer.of(refused.failure)
    scene = _scene_from(situation, options.scene_diff, state, context)
    if isinstance(scene, PlanningFailure):
        return Answer.of(scene)
    warnings = [*situation.warnings, *options.warnings]
    refusal = _refusal(asked.requests, situation.start_rad, context, warnings)
    if refusal is not None:
        return Answer.of(refusal)
    planned = await plan_sequence(
        tuple(context.step(request) for request in asked.requests), situation.start_rad, scene, context.pool.ask
    )
    if planned.failure is not None:
        context.display.contacts_of(planned.failure.details)
        return Answer.of(planned.failure, planned.performed)
    context.display.performed(planned.performed)
    message = "; ".join((planned.summary, *planned.notes, *warnings))
    return Answer(MoveItErrorCode.SUCCESS, message, performed=planned.performed)


def _refusal(
    requests: Sequence[Message], start_rad: Positions, context: PlanningContext, warnings: list[str]
) -> PlanningFailure | None:
    """Why the requests cannot be asked for; None when they can. Warnings are added to those given."""
    for request in requests:
        read = context.read(request, start_rad)
        if isinstance(read, PlanningFailure):
            return read
        warnings.extend(read.warnings)
    return None


def _scene_of(
    scene_diff: Message | None, context: PlanningContext
) -> Callable[[Positions], Scene | PlanningFailure] | None:
    """What scene a motion is planned in, None for the present one."""
    if scene_diff is None:
        return None
    return lambda present_rad: context.scene_state.with_diff(scene_diff, present_rad)


def _scene_from(
    situation: Situation, scene_diff: Message | None, state: Message, context: PlanningContext
) -> Scene | PlanningFailure:
    """The scene of a start state, with what the options change in it."""
    if scene_diff is None:
        return situation.scene
    return context.scene_state.with_diff({**scene_diff, **(attached_diff(state) or {})}, situation.start_rad)


def _start_ignored(requests: Sequence[Message]) -> list[str]:
    """What MoveIt says too: a motion that is carried out begins where the arm is."""
    named = any(request["start_state"]["joint_state"]["name"] for request in requests)
    return ["start_state is ignored: the motion begins where the arm is"] if named else []
