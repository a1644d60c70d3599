"""Messages that are just as their types declare them: read, checked and written in C, without the objects in between.

msgspec decodes JSON into a struct in one pass and refuses missing, unknown and mistyped fields. A refused message
is left to :mod:`protocol.messages`, which forgives more and names the problem. What it takes comes out of both ways
alike, except that the general way also fills in and converts. A relayed message takes a third of the time so.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec

from protocol import values
from protocol.errors import InterfaceError
from protocol.operations import MAX_ID_CHARACTERS, MAX_NAME_CHARACTERS
from protocol.registry import MAX_COMPILED_TYPES, OCTETS, ArrayBounds, Field, MessageType, Registry

_encode = msgspec.json.Encoder().encode


class _UnsuitedError(Exception):
    """A message type cannot be checked by msgspec alone."""


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def publication_reader(registry: Registry, type_name: str) -> PublicationReader | None:
    """Return the reader of a message type's publications, None for a type that has none, such as an unknown one."""
    try:
        return PublicationReader(registry, registry.message(type_name))
    except (InterfaceError, _UnsuitedError):
        return None


class PublicationReader:
    """Reads the publish operations of one message type from JSON, and writes their messages in ASCII."""

    def __init__(self, registry: Registry, message_type: MessageType) -> None:
        self._octets = tuple(_octet_arrays(registry, message_type, ""))
        mark = Annotated[str, msgspec.Meta(max_length=MAX_ID_CHARACTERS)] | int | None
        type_name = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_NAME_CHARACTERS)] | None
        # Any other field, such as fragment_size, is left to the general way; so is a true latch.
        operation = msgspec.defstruct(
            "Publish",
            [
                ("op", Literal["publish"]),
                ("topic", str),
                ("msg", _struct(registry, message_type)),
                ("id", mark, None),
                ("type", type_name, None),
                ("latch", bool, False),
                ("queue_size", Annotated[int, msgspec.Meta(ge=0)], 100),
            ],
            forbid_unknown_fields=True,
        )
        self._decode: Callable[[str], Any] = msgspec.json.Decoder(operation).decode

    def read(self, frame: str, topic: str) -> bytes | None:
        """Return the message of a publish operation as JSON in ASCII.

        None for any other frame, another topic, a latch, or a message that does not match its type exactly.
        """
        try:
            operation = self._decode(frame)
        except (msgspec.DecodeError, UnicodeEncodeError):
            return None
        if operation.topic != topic or operation.latch or not self._suits(operation.msg):
            return None
        message = _encode(operation.msg)
        return message if message.isascii() else None

    def _suits(self, message: msgspec.Struct) -> bool:
        """Return True where the octets of a message are spelled as they go out, and not too many."""
        for get, bounds in self._octets:
            count = values.octets_in(get(message))
            if count is None or (bounds.max_length is not None and not bounds.min_length <= count <= bounds.max_length):
                return False
        return True


def _struct(registry: Registry, message_type: MessageType, *, in_list: bool = False) -> type[msgspec.Struct]:
    # Fields may be called as Python's keywords or as methods are, so they get numbers for names.
    fields = [
        (_attribute(place), _annotation(registry, field, in_list)) for place, field in enumerate(message_type.fields)
    ]
    rename = {_attribute(place): field.name for place, field in enumerate(message_type.fields)}
    return msgspec.defstruct("Message", fields, rename=rename, forbid_unknown_fields=True)


def _annotation(registry: Registry, field: Field, in_list: bool) -> Any:
    is_octet_text = _is_octet_text(field)
    if is_octet_text and not in_list:
        return str
    in_list = in_list or field.array is not None
    if field.primitive:
        single = values.strict_type(field.base, field.max_length)
    else:
        single = _struct(registry, registry.message(field.base), in_list=in_list)
    if single is None or is_octet_text:
        raise _UnsuitedError
    if field.array is None:
        return single
    bounds = msgspec.Meta(min_length=field.array.min_length, max_length=field.array.max_length)
    return Annotated[list[single], bounds]  # type: ignore[valid-type]


def _octet_arrays(
    registry: Registry, message_type: MessageType, path: str
) -> list[tuple[Callable[[Any], str], ArrayBounds]]:
    found: list[tuple[Callable[[Any], str], ArrayBounds]] = []
    for place, field in enumerate(message_type.fields):
        here = path + _attribute(place)
        if field.array is not None and _is_octet_text(field):
            found.append((operator.attrgetter(here), field.array))
        elif field.array is None and not field.primitive:
            found += _octet_arrays(registry, registry.message(field.base), f"{here}.")
    return found


def _is_octet_text(field: Field) -> bool:
    """Return True for an array that goes out as base64 text; byte[] goes out as a list of integers."""
    return field.array is not None and field.base in OCTETS


def _attribute(place: int) -> str:
    return f"f{place}"
