"""Refused requests on their way out of a translation: raised where the flaw is found, data for whoever asked."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure
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
