"""Messages that are just as their types declare them: read, checked and written in C.

msgspec decodes JSON into a struct in one pass and refuses missing, unknown and mistyped fields. A refused message
is left to :mod:`protocol.messages`, which forgives more and names the problem. What it takes comes out of both ways
alike, except that the general way also fills in and converts.
"""

import functools
import operator
from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec

from protocol import values
from protocol.operations import MAX_ID_CHARACTERS, MAX_NAME_CHARACTERS
from protocol.registry import MAX_COMPILED_TYPES, TEXTS, ArrayBounds, Field, MessageType, Registry

# The largest finite number of IEEE 754 single precision.
_FLOAT32_MAX = 3.4028234663852886e38

_PLAIN: dict[str, Any] = {
    "bool": bool,
    "float64": float,
    "float32": Annotated[float, msgspec.Meta(ge=-_FLOAT32_MAX, le=_FLOAT32_MAX)],
}

_encode = msgspec.json.Encoder().encode


class _UnsuitedError(Exception):
    """A message type cannot be checked by msgspec alone."""


class StrictType:
    """Message type, for messages that leave nothing out; ``struct`` has the fields' names as they are sent."""

    def __init__(self, registry: Registry, type_name: str) -> None:
        writer = _Writer(registry)
        message_type = registry.message(type_name)
        self.struct = writer.struct(message_type)
        self.has_lists_of_messages = writer.has_lists_of_messages
        self._octets = tuple(_octet_arrays(registry, message_type, ""))

    def complete(self, value: object) -> dict[str, Any] | None:
        """Copy a decoded message, whole numbers as floats where the type has floats; None if it does not match."""
        if type(value) is not dict:
            return None
        try:
            message = msgspec.convert(value, self.struct)
        except (msgspec.ValidationError, OverflowError):
            return None
        if not self.suits(message):
            return None
        completed: dict[str, Any] = msgspec.to_builtins(message)
        return completed

    def suits(self, message: msgspec.Struct) -> bool:
        """Return True where the octets of a message are spelled as they go out, and not too many."""
        for get, bounds in self._octets:
            count = values.octets_in(get(message))
            if count is None or (bounds.max_length is not None and not bounds.min_length <= count <= bounds.max_length):
                return False
        return True


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def strict_type(registry: Registry, type_name: str) -> StrictType | None:
    """Return the strict form of a message type, None for a type that has none."""
    try:
        return StrictType(registry, type_name)
    except _UnsuitedError:
        return None


class PublicationReader:
    """Reads the publish operations of one message type from JSON, and writes their messages in ASCII."""

    def __init__(self, strict: StrictType) -> None:
        self._suits = strict.suits
        mark = Annotated[str, msgspec.Meta(max_length=MAX_ID_CHARACTERS)] | int | None
        type_name = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_NAME_CHARACTERS)] | None
        # Any other field, such as fragment_size, is left to the general way; so is a true latch.
        operation = msgspec.defstruct(
            "Publish",
            [
                ("op", Literal["publish"]),
                ("topic", str),
                ("msg", strict.struct),
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


class _Writer:
    def __init__(self, registry: Registry) -> None:
        self.has_lists_of_messages = False
        self._registry = registry

    def struct(self, message_type: MessageType, *, in_list: bool = False) -> type[msgspec.Struct]:
        # Fields may be called as Python's keywords or as methods are, so they get numbers for names.
        fields = [
            (_attribute(place), self._annotation(field, in_list=in_list))
            for place, field in enumerate(message_type.fields)
        ]
        rename = {_attribute(place): field.name for place, field in enumerate(message_type.fields)}
        return msgspec.defstruct("Message", fields, rename=rename, forbid_unknown_fields=True)

    def _annotation(self, field: Field, *, in_list: bool) -> Any:
        if field.array is None:
            return self._single(field, in_list=in_list)
        bounds = msgspec.Meta(min_length=field.array.min_length, max_length=field.array.max_length)
        if _is_octet_text(field):
            if in_list:
                raise _UnsuitedError
            return str
        if not field.primitive:
            self.has_lists_of_messages = True
        return Annotated[list[self._single(field, in_list=True)], bounds]  # type: ignore[misc]

    def _single(self, field: Field, *, in_list: bool) -> Any:
        if not field.primitive:
            return self.struct(self._registry.message(field.base), in_list=in_list)
        if field.base in TEXTS:
            return str if field.max_length is None else Annotated[str, msgspec.Meta(max_length=field.max_length)]
        if field.base not in values.INTEGER_RANGES:
            return _PLAIN[field.base]
        lowest, highest = values.INTEGER_RANGES[field.base]
        # msgspec takes no bounds beyond 64 bits with a sign.
        if highest >= 1 << 63:
            raise _UnsuitedError
        return Annotated[int, msgspec.Meta(ge=lowest, le=highest)]


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
    return field.array is not None and field.base in ("uint8", "char")


def _attribute(place: int) -> str:
    return f"f{place}"
