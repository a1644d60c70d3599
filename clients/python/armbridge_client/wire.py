"""Messages as dataclasses, and their form in rosbridge's JSON."""

from __future__ import annotations

import base64
import dataclasses
import functools
import math
import typing
from collections.abc import Callable, Hashable, Mapping
from typing import Any, ClassVar, Generic, TypeGuard, TypeVar

M = TypeVar("M", bound="Message")
Response = TypeVar("Response", bound="Message")
Result = TypeVar("Result", bound="Message")
Feedback = TypeVar("Feedback", bound="Message")


class Message:
    """A message of the server's type tables; subclasses are dataclasses whose defaults are the tables'."""

    TYPE: ClassVar[str] = ""

    def __repr__(self) -> str:
        given = (f"{name}={getattr(self, name)!r}" for name in to_wire(self))
        return f"{type(self).__name__}({', '.join(given)})"


class Service(Message, Generic[Response]):
    """Request of a service; ``TYPE`` is the service's type."""


class Action(Message, Generic[Result, Feedback]):
    """Goal of an action; ``TYPE`` is the action's type."""


def answer_class(request: type[Message], number: int = 0) -> type[Any]:
    """Return the class of the response of a request, of the result (0) or the feedback (1) of a goal."""
    answer: type[Any] = typing.get_args(request.__orig_bases__[0])[number]  # type: ignore[attr-defined]
    return answer


def to_wire(message: Message) -> dict[str, Any]:
    """Return a message for JSON, without the fields that have their defaults: the server completes it."""
    values: dict[str, Any] = {}
    for each in dataclasses.fields(message):  # type: ignore[arg-type]
        value = getattr(message, each.name)
        default = each.default if each.default_factory is dataclasses.MISSING else each.default_factory()
        if value != default:
            values[each.name] = _encoded(value)
    return values


def _encoded(value: Any) -> Any:
    if isinstance(value, Message):
        return to_wire(value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return [_encoded(each) for each in value] if _is_list(value) else value


def _is_list(value: Any) -> TypeGuard[list[Any]]:
    return isinstance(value, list)


def from_wire(message_class: type[M], values: Mapping[str, Any]) -> M:
    """Return a message of JSON values; missing fields get their defaults, unknown fields are ignored."""
    # The class is hashable; its messages, which may change, are not.
    decoders = _decoders(typing.cast("Hashable", message_class))
    return message_class(**{name: decoders[name](value) for name, value in values.items() if name in decoders})


@functools.cache
def _decoders(message_class: Any) -> Mapping[str, Callable[[Any], Any]]:
    hints = typing.get_type_hints(message_class)
    return {each.name: _decoder(hints[each.name]) for each in dataclasses.fields(message_class)}


def _decoder(declared: Any) -> Callable[[Any], Any]:
    if typing.get_origin(declared) is list:
        decode = _decoder(typing.get_args(declared)[0])
        return lambda values: [decode(value) for value in values]
    if declared is float:
        return lambda value: math.nan if value is None else float(value)
    if declared is bytes:
        return lambda value: base64.b64decode(value) if isinstance(value, str) else bytes(value)
    if issubclass(declared, Message):
        return functools.partial(from_wire, declared)
    return lambda value: declared(value)
