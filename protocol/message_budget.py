"""A bound on what a message grows to when it is completed.

An element of a list may leave all its fields out: ``{}`` stands for a whole planning request. So a message of a few
megabytes could hold the server up for minutes, and take all its memory.
"""

from __future__ import annotations

import functools

from protocol.errors import MessageError
from protocol.registry import Registry

# Values of the elements of all lists of messages in one message. The largest mesh that is taken into a scene has half
# as many; completing them takes two seconds at worst, and 150 MB.
MAX_VALUES = 1_000_000


class MessageBudget:
    """What is left to one message; messages are completed one after the other."""

    __slots__ = ("_left",)

    def __init__(self) -> None:
        self._left = MAX_VALUES

    def renew(self) -> None:
        """Begin with a message."""
        self._left = MAX_VALUES

    def take(self, count: int) -> None:
        """Take so many values.

        Raises:
            MessageError: there are not so many left.
        """
        self._left -= count
        if self._left < 0:
            raise MessageError(f"at most {MAX_VALUES} values in all lists of messages, as they are complete", "more")


# One for all, for a message that is completed waits for nothing.
BUDGET = MessageBudget()


@functools.cache
def values_in(registry: Registry, type_name: str) -> int:
    """How many values a message of a type has at least, the messages in it included, its lists counted as one each."""
    fields = registry.message(type_name).fields
    return sum(1 if field.primitive or field.array else values_in(registry, field.base) for field in fields) or 1
