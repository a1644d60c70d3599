"""Refusals of requests, as values."""

from collections.abc import Callable
from typing import Any

from planners.problem import PlanningError, PlanningFailure


def refusal(check: Callable[..., Any], *arguments: Any, **named: Any) -> PlanningFailure | None:
    """Return the failure that a check raises, None where it raises none."""
    try:
        check(*arguments, **named)
    except PlanningError as error:
        return error.failure
    return None
