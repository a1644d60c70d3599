"""Errors that reject a request, and moveit_msgs/MoveItErrorCodes of responses.

Everything that reads a request raises :exc:`RefusedError`; services, actions and topics catch it where they answer.
"""

from __future__ import annotations

from typing import Any, ParamSpec, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure
from server.errors import RefusedError

Found = TypeVar("Found")
Arguments = ParamSpec("Arguments")

# MoveIt puts the name of the pipeline's stage there.
SOURCE = "armbridge"


def refused(code: MoveItErrorCode, message: str, **details: Any) -> RefusedError:
    """Make the error that rejects a request."""
    return RefusedError(PlanningFailure(code, message, details))


def invalid(message: str, **details: Any) -> RefusedError:
    """Make the error that rejects a goal or a constraint."""
    return refused(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, **details)


def required(found: Found | PlanningFailure) -> Found:
    """Return an answer of the planners, or a frame's pose."""
    if isinstance(found, PlanningFailure):
        raise RefusedError(found)
    return found


def error_code(code: MoveItErrorCode, message: str = "", source: str = SOURCE) -> dict[str, Any]:
    """Write a moveit_msgs/MoveItErrorCodes."""
    return {"val": int(code), "message": message, "source": source}


def success(*notes: str) -> dict[str, Any]:
    """Write the code of a success; notes that are not empty become its message."""
    return error_code(MoveItErrorCode.SUCCESS, "; ".join(note for note in notes if note))


def failure_code(failure: PlanningFailure) -> dict[str, Any]:
    """Write the code of a failure, with its message."""
    return error_code(failure.code, failure.message)
