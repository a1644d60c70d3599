"""Errors of the server; the text of each is one sentence for the user."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

from planners.problem import MoveItErrorCode, PlanningFailure

Found = TypeVar("Found")


class ServerError(Exception):
    """Base of the server's errors."""


class GraphError(ServerError):
    """An operation that the graph refuses."""

    def __init__(self, kind: Literal["topic", "service", "action"], name: str, message: str) -> None:
        super().__init__(f"{kind} {name}: {message}")
        self.name = name


class ServiceError(ServerError):
    """A service that cannot do what it is asked for; its caller gets the text."""


class NoAnswerError(ServiceError):
    """A provider elsewhere that gives no answer that could be passed on: the call fails."""


class FileTooLargeError(ServiceError):
    """A file that has more bytes than are served."""


class UnsuccessfulError(ServerError):
    """A service that has not succeeded, as its response says, which has no field for the reason."""

    def __init__(self, response: object, reason: str) -> None:
        super().__init__(reason)
        self.response = response


class RefusedError(ServerError):
    """A request that cannot be carried out."""

    def __init__(self, failure: PlanningFailure) -> None:
        super().__init__(failure.message)
        self.failure = failure


def refused(code: MoveItErrorCode, message: str, **details: Any) -> RefusedError:
    return RefusedError(PlanningFailure(code, message, details))


def invalid(message: str, **details: Any) -> RefusedError:
    return refused(MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, message, **details)


def invalid_plan(message: str, **details: Any) -> RefusedError:
    return refused(MoveItErrorCode.INVALID_MOTION_PLAN, message, **details)


def required(found: Found | PlanningFailure) -> Found:
    """Return an answer of the planners, or a frame's pose; raise RefusedError for a failure."""
    if isinstance(found, PlanningFailure):
        raise RefusedError(found)
    return found


class ConfigurationError(ServerError):
    """A setting that is wrong or contradicts another."""


class RecordingError(ServerError):
    """A recording that cannot be read."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(f"recording {path}: {problem}")


class StartError(ServerError):
    """A part of the server that cannot start."""


# Of values whose kind pydantic calls by the name of a Python type.
_TABLE = "must be a table, as in { name = value }"
_KINDS = {
    "tuple_type": 'must be a list, as in ["first", "second"]',
    "dict_type": _TABLE,
    "model_type": _TABLE,
    "string_type": "must be a text, in quotes",
    "missing": "is missing",
}


def sentence_of(flaw: Mapping[str, Any]) -> str:
    """Return the sentence of one of ``ValidationError.errors()``; a validator's own sentence as it stands."""
    sentence = str(flaw["msg"]).removeprefix("Value error, ").replace("Input should be", "must be", 1)
    return _KINDS.get(flaw["type"], sentence)
