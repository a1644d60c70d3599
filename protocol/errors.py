"""Errors of the wire protocol, as one tree.

ProtocolError
├── InterfaceError    a type name that the interface tables do not know
├── InterfaceFilesError    interface files of the user that cannot be used
├── MessageError      a message that does not fit its type
├── LargeMessageError a message that takes longer to complete than everybody may be kept waiting
├── OperationError    an operation that is unknown, incomplete or senseless
│   └── NothingToDoError    nothing to withdraw
└── FrameError        a frame that cannot be decoded
"""

from __future__ import annotations

from collections.abc import Sequence

# What came is quoted in one line of a log or a status message; more of it helps nobody.
MAX_QUOTED_CHARACTERS = 60

# Beyond 64 bits a number has no place in a ROS message, and its digits would fill the line.
MAX_QUOTED_BITS = 64


class ProtocolError(Exception):
    """Base of all refusals of this package; ``str(error)`` is one line, fit for a log and for the client."""


class InterfaceError(ProtocolError):
    """A type name that the interface tables do not know."""

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(f"type {describe(type_name)}: {problem}")


class InterfaceFilesError(ProtocolError):
    """Interface files of the user that cannot be used; ``str(error)`` has a line for each problem."""

    def __init__(self, problems: Sequence[object]) -> None:
        count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
        super().__init__("\n".join((f"{count} in interface files:", *(f"  {each}" for each in problems))))
        self.problems = tuple(problems)


class MessageError(ProtocolError):
    """A value that does not fit the field at ``path``, as ``points[3].positions[0]``; empty for the message itself."""

    def __init__(self, wanted: str, got: str, path: str = "") -> None:
        super().__init__(wanted, got, path)
        self.wanted = wanted
        self.got = got
        self.path = path

    def __str__(self) -> str:
        place = f"field {self.path}" if self.path else "message"
        return f"{place}: wanted {self.wanted}, got {self.got}"

    def inside(self, step: str) -> MessageError:
        """Return this error as seen from one level further out."""
        # An index follows its field without a dot.
        separator = "" if not self.path or self.path.startswith("[") else "."
        return MessageError(self.wanted, self.got, f"{step}{separator}{self.path}")


class LargeMessageError(ProtocolError):
    """A message of more values than may be completed while everybody waits; complete it in the background."""

    def __init__(self, type_name: str) -> None:
        super().__init__(f"a message of type {type_name} is too large to be completed at once")


class OperationError(ProtocolError):
    """An operation that is unknown, incomplete, senseless, or one too many."""

    def __init__(self, op: str | None, field: str | None, problem: str) -> None:
        place = [op] if op else []
        place += [f"field {field}"] if field else []
        super().__init__(": ".join([*place, problem]))
        self.op = op
        self.field = field


class NothingToDoError(OperationError):
    """An operation with nothing to withdraw: harmless, but hardly meant."""


class FrameError(ProtocolError):
    """A frame that cannot be decoded; ``position`` is the index of the offending character or byte."""

    def __init__(self, problem: str, position: int | None = None) -> None:
        super().__init__(problem if position is None else f"{problem} at position {position}")


def shorten(text: str) -> str:
    """Cut text to `MAX_QUOTED_CHARACTERS`, so that no client decides how long a line of the log is."""
    return text if len(text) <= MAX_QUOTED_CHARACTERS else f"{text[:MAX_QUOTED_CHARACTERS]}..."


def one_line(text: str) -> str:
    """Escape line breaks and other control characters, so that no client writes lines of its own into the log."""
    return text if text.isprintable() else repr(text)[1:-1]


def describe(value: object) -> str:
    """Say in a few words what came, in JSON's terms."""
    if isinstance(value, str):
        return repr(shorten(value))
    if isinstance(value, dict):
        return f"an object of {len(value)} fields"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    # Checked before repr, which raises for integers of more than 4300 digits.
    if isinstance(value, int) and value.bit_length() > MAX_QUOTED_BITS:
        return f"an integer of {value.bit_length()} bits"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return repr(value)[:MAX_QUOTED_CHARACTERS]
