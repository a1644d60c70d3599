"""Errors of requests"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from planners.problem import Deviation, MoveItErrorCode, PlanningFailure
from server.errors import RefusedError

Found = TypeVar("Found")
Arguments = ParamSpec("Arguments")


def refused(code: MoveItErrorCode, message: str, **details: Any) -> RefusedError:
    """A refusal to raise.

    Args:
        code: what is true of the case.
        message: one sentence that names field, value and limit.
        details: the same as plain values.
    """
    return RefusedError(PlanningFailure(code, message, details))


def invalid(message: str, **details: Any) -> RefusedError:
    """A refusal of a goal or a constraint to raise."""
    return refused(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, **details)


def required(found: Found | PlanningFailure) -> Found:
    """What was found; a failure is raised as a refusal.

    Raises:
        RefusedError: there is a failure instead.
    """
    if isinstance(found, PlanningFailure):
        raise RefusedError(found)
    return found


def refusals_as_data(function: Callable[Arguments, Found]) -> Callable[Arguments, Found | PlanningFailure]:
    """Make a function return the refusals that it raises."""

    @functools.wraps(function)
    def told(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Found | PlanningFailure:
        try:
            return function(*args, **kwargs)
        except RefusedError as error:
            return error.failure

    return told


# A deviation below these is what a servo arm has anyway [m], [rad].
TOLD_POSITION_M = 0.001
TOLD_ORIENTATION_RAD = 0.01

# Who says it; MoveIt puts the name of the pipeline's stage there.
SOURCE = "armbridge"


def error_code(code: MoveItErrorCode, message: str = "", source: str = SOURCE) -> dict[str, Any]:
    """A moveit_msgs/MoveItErrorCodes.

    Args:
        code: the value.
        message: one sentence.
        source: who says it.
    """
    return {"val": int(code), "message": message, "source": source}


def success(*notes: str) -> dict[str, Any]:
    """The code of a success, with what the caller should know all the same."""
    return error_code(MoveItErrorCode.SUCCESS, "; ".join(note for note in notes if note))


def failure_code(failure: PlanningFailure) -> dict[str, Any]:
    """The code of a failure, with its sentence."""
    return error_code(failure.code, failure.message)


def deviation_note(deviation: Deviation) -> str:
    """What of the goal could not be had, as a sentence; empty when all could."""
    said = []
    if deviation.position_m > TOLD_POSITION_M:
        said.append(f"the position is {1000.0 * deviation.position_m:.1f} mm off")
    if deviation.orientation_rad > TOLD_ORIENTATION_RAD:
        said.append(
            f"the orientation is {math.degrees(deviation.orientation_rad):.1f} degrees off, the nearest there is"
        )
    return " and ".join(said)
