"""Limits of the lists in requests, goals and messages to the server, checked before a message is completed.

An element of a list may leave all its fields out: ``{}`` stands for a whole planning request. So the lengths of its
lists tell what a message costs, and not its size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from protocol.errors import MessageError
from protocol.messages import values_in
from protocol.registry import Field, Registry
from server.graph.message_types import ReceivedMessage

# To complete and to read a value takes up to 2 us. A planning request with constraints has some hundred values.
MAX_VALUES = 5_000

# Raises MessageError for a message, as it was decoded, with more than its lists may have.
CheckLists: TypeAlias = Callable[[object], None]


@dataclass(frozen=True)
class ListLimits:
    """Limits of the lists in one message."""

    # Number of elements in all lists of a field together, by type and field such as
    # ``moveit_msgs/msg/MotionSequenceRequest.items``.
    max_elements: Mapping[str, int] = field(default_factory=dict)
    max_values: int = MAX_VALUES  # number of values in all other lists, of messages as they are when complete

    def check(self, registry: Registry, type_name: str) -> CheckLists:
        """Return the check of a type's messages; their fields may also come as a list, in order of declaration."""
        counted = _counted(registry, type_name, "", self.max_elements)
        names = tuple(each.name for each in registry.message(type_name).fields)

        def check(message: object) -> None:
            value = message.value if isinstance(message, ReceivedMessage) else message
            # A message that was completed in the background comes again.
            if isinstance(message, ReceivedMessage) and message.checked:
                return
            by_name = dict(zip(names, value, strict=False)) if isinstance(value, list) else value
            _check(by_name, counted, self.max_values)
            if isinstance(message, ReceivedMessage):
                message.checked = True

        return check


@dataclass(frozen=True, eq=False)
class _Member:
    path: str
    is_list: bool
    max_elements: int | None
    values: int
    inner: _Members


# Members of a type by name.
_Members: TypeAlias = tuple[tuple[str, _Member], ...]


def _counted(registry: Registry, type_name: str, path: str, max_elements: Mapping[str, int]) -> _Members:
    message_type = registry.message(type_name)
    found = []
    for each in message_type.fields:
        place = f"{path}.{each.name}" if path else each.name
        limit = max_elements.get(f"{message_type.name}.{each.name}")
        member = _member(registry, each, place, limit, max_elements)
        if member is not None:
            found.append((each.name, member))
    return tuple(found)


def _member(
    registry: Registry, each: Field, path: str, limit: int | None, max_elements: Mapping[str, int]
) -> _Member | None:
    if each.primitive:
        # A list of fixed length is refused by its length.
        if each.array is None or (limit is None and each.array.max_length is not None):
            return None
        return _Member(path, is_list=True, max_elements=limit, values=1, inner=())
    if each.array is None:
        inner = _counted(registry, each.base, path, max_elements)
        return _Member(path, is_list=False, max_elements=None, values=0, inner=inner) if inner else None
    inner = _counted(registry, each.base, f"{path}[]", max_elements)
    return _Member(path, is_list=True, max_elements=limit, values=values_in(registry, each.base), inner=inner)


def _check(message: object, counted: _Members, max_values: int) -> None:
    elements: dict[_Member, int] = {}
    values = 0
    # What does not fit its type is left to the completion, which refuses it.
    pending: list[tuple[list[Any], _Members]] = [([message], counted)]
    while pending:
        messages, members = pending.pop()
        for each in messages:
            if type(each) is not dict:
                continue
            for name, member in members:
                content = each.get(name)
                if not content:
                    continue
                if type(content) is not list:
                    if not member.is_list:
                        pending.append(([content], member.inner))
                    continue
                if member.max_elements is None:
                    values += len(content) * member.values
                    if values > max_values:
                        wanted = f"at most {max_values} values in all lists, as they are complete"
                        raise MessageError(wanted, "more", member.path)
                else:
                    count = elements[member] = elements.get(member, 0) + len(content)
                    if count > member.max_elements:
                        raise MessageError(f"at most {member.max_elements} elements in all", str(count), member.path)
                if member.inner:
                    pending.append((content, member.inner))
