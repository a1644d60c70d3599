"""Types of the messages in the graph, and their completion, at once or in the background."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from protocol import dialect, messages
from protocol.dialect import Dialect
from protocol.errors import InterfaceError, LargeMessageError, MessageError, describe
from protocol.messages import MAX_VALUES, ListLimits, Stamp
from protocol.publication import LARGE_BYTES
from protocol.registry import Kind, Registry

# Values of the lists of one client's message beyond which a thread completes it: 10 ms at the slowest.
VALUES_AT_ONCE = 4_000

# Size from which a thread completes a message in any case [bytes]; in ROS 1 spelling it is translated as well.
BYTES_AT_ONCE = 32_768
ROS1_BYTES_AT_ONCE = 8_192

# An element of a list may be sent as `{}` and stand for hundreds of values. A message may have this
# number, and one more for each byte that came.
FREE_VALUES = 20_000


@dataclass(slots=True, eq=False)
class ReceivedMessage:
    """Message as a client has sent it, until it is completed."""

    value: object
    size_bytes: int
    dialect: Dialect = "ros2"
    light: bool = False  # True for a message that is completed and encoded quickly, however large it is
    are_arguments: bool = False  # True for a request or a goal, whose fields may come in order of declaration
    limits: ListLimits | None = None  # limits of its reader
    values: int = 0
    _type_name: str | None = None
    _completed: dict[str, Any] | MessageError | None = None

    @property
    def cost_bytes(self) -> int:
        """Cost of encoding the completed message, as an amount of JSON [bytes]."""
        return self.size_bytes if self._completed is None else max(self.size_bytes, LARGE_BYTES)

    def completed(self, type_name: str) -> dict[str, Any] | None:
        """Return the message as a thread has completed it for a type; None when none has."""
        if self._completed is None or self._type_name != type_name:
            return None
        if isinstance(self._completed, MessageError):
            raise self._completed
        return self._completed

    def complete(self, types: MessageTypes, type_name: str) -> None:
        """Complete the message for a type, in any thread."""
        try:
            completed: dict[str, Any] | MessageError = types.complete_received(type_name, self, types.now(), MAX_VALUES)
        except MessageError as error:
            completed = error
        self._completed, self._type_name = completed, type_name


class PostponedError(Exception):
    """A client's message would take too long to complete in the event loop; nothing has been done with it yet."""

    def __init__(self, message: ReceivedMessage, type_name: str) -> None:
        super().__init__(f"a message of type {type_name} must be completed in the background")
        self.message = message
        self.type_name = type_name


class MessageTypes:
    """Types and messages of publishers and callers."""

    def __init__(
        self, registry: Registry, wall_clock: Callable[[], float] = time.time, *, relay_unknown_types: bool = False
    ) -> None:
        self.registry = registry
        self.wall_clock = wall_clock
        self._relay_unknown_types = relay_unknown_types

    def canonical(self, name: str, kind: Kind) -> str:
        """Return the three-part name of a type, or raise InterfaceError."""
        try:
            return self.registry.canonical(name, kind)
        except InterfaceError:
            parts = name.split("/")
            if not self._relay_unknown_types or len(parts) not in (2, 3):
                raise
            return f"{parts[0]}/{kind}/{parts[-1]}"

    def now(self) -> Stamp:
        """Return the present time, as the time of receipt of a message."""
        return Stamp.from_seconds(self.wall_clock())

    def complete(
        self, type_name: str, value: object, received: Stamp | None = None, limits: ListLimits | None = None
    ) -> dict[str, Any]:
        """Validate a message and fill in what it leaves out; see `protocol.messages.complete`.

        Raises MessageError, and PostponedError for a client's message that is too large to be completed at once.
        """
        if not isinstance(value, ReceivedMessage):
            return self._complete(type_name, value, received, MAX_VALUES, MAX_VALUES, limits)
        completed = value.completed(type_name)
        if completed is not None:
            return completed
        value.limits = limits
        if limits is not None and limits.max_bytes is not None and value.size_bytes > limits.max_bytes:
            raise MessageError(f"at most {limits.max_bytes} bytes", str(value.size_bytes))
        if not value.light and value.size_bytes > (BYTES_AT_ONCE if value.dialect == "ros2" else ROS1_BYTES_AT_ONCE):
            raise PostponedError(value, type_name)
        try:
            return self.complete_received(type_name, value, received, VALUES_AT_ONCE)
        except LargeMessageError:
            raise PostponedError(value, type_name) from None

    def complete_arguments(self, type_name: str, arguments: object, limits: ListLimits | None = None) -> dict[str, Any]:
        """Complete a request or a goal, given as rosbridge's ``args``: fields by name or in order, else none."""
        if isinstance(arguments, ReceivedMessage):
            arguments.are_arguments = True
            return self.complete(type_name, arguments, limits=limits)
        return self.complete(type_name, self._by_name(type_name, arguments), limits=limits)

    def complete_received(
        self, type_name: str, message: ReceivedMessage, received: Stamp | None, max_values_at_once: int
    ) -> dict[str, Any]:
        """Complete a message of a client, in any thread."""
        value = message.value
        if message.dialect == "ros1" and self.registry.knows(type_name):
            value = dialect.from_ros1(self.registry, type_name, value)
        if message.are_arguments:
            value = self._by_name(type_name, value)
        max_values = min(MAX_VALUES, FREE_VALUES + message.size_bytes)
        completed = self._complete(type_name, value, received, max_values, max_values_at_once, message.limits)
        message.values = messages.BUDGET.taken
        return completed

    def _complete(
        self,
        type_name: str,
        value: object,
        received: Stamp | None,
        max_values: int,
        max_values_at_once: int,
        limits: ListLimits | None,
    ) -> dict[str, Any]:
        try:
            return messages.complete(
                self.registry, type_name, value, received or self.now(), max_values, max_values_at_once, limits
            )
        except InterfaceError:
            # Only types that `canonical` let through get here: nothing is known that could be checked.
            if not isinstance(value, dict):
                raise MessageError(type_name, describe(value)) from None
            return value

    def _by_name(self, type_name: str, arguments: object) -> dict[str, Any]:
        if isinstance(arguments, dict):
            return arguments
        if not isinstance(arguments, list):
            return {}
        try:
            names = [field.name for field in self.registry.message(type_name).fields]
        except InterfaceError:
            raise MessageError(f"{type_name} as an object", describe(arguments)) from None
        # rosbridge_library drops arguments beyond the fields, and callers rely on it.
        return dict(zip(names, arguments, strict=False))
