"""Primitive values of a message: validates what came and converts it to what the type stores.

Every converter takes a decoded value and returns it as the type wants it, or raises MessageError. It
accepts: an integer for a float, a whole float for an integer, null for a float (NaN goes out as null, so
null comes back as NaN), and in a list true and false for numbers (a gamepad's buttons).
"""

from __future__ import annotations

import functools
import math
import struct
from collections.abc import Callable
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
import pybase64

from protocol.errors import MessageError, describe
from protocol.registry import MAX_COMPILED_TYPES, TEXTS, Field

T = TypeVar("T")
Primitive: TypeAlias = bool | int | float | str
Convert: TypeAlias = Callable[[object], Primitive]
ConvertList: TypeAlias = Callable[[list[Any]], list[Any] | None]

INTEGER_RANGES = {
    # ROS 2 stores byte and char as octets.
    "byte": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}

# The largest finite number of IEEE 754 single precision.
_FLOAT32_MAX = 3.4028234663852886e38

_STRICT_TYPES: dict[str, Any] = {
    "bool": bool,
    "float64": float,
    "float32": Annotated[float, msgspec.Meta(ge=-_FLOAT32_MAX, le=_FLOAT32_MAX)],
}


def zero(name: str) -> Primitive:
    """Return the value of a primitive field that nobody set."""
    if name in INTEGER_RANGES:
        return 0
    if name == "bool":
        return False
    return "" if name in TEXTS else 0.0


def default(field: Field) -> Any:
    """Return the value of a primitive field that nobody set: its default, else zeros; of an array a list of its own."""
    if field.array is None:
        return zero(field.base) if field.default is None else field.default
    if isinstance(field.default, tuple):
        return list(field.default)
    return [zero(field.base)] * field.array.min_length


def to_bool(value: object) -> bool:
    """Take true or false; a number is no truth value."""
    # Exact types throughout this module: isinstance would take a bool for an int, which a ROS field is not.
    if type(value) is bool:
        return value
    raise MessageError("bool", describe(value))


def to_float64(value: object) -> float:
    if type(value) is float:
        return value
    if value is None:
        return math.nan
    if type(value) is int:
        try:
            return float(value)
        except OverflowError as error:
            raise MessageError("float64", describe(value)) from error
    raise MessageError("float64", describe(value))


def to_float32(value: object) -> float:
    """Take a number within the range of IEEE 754 single precision, or null; its digits are kept."""
    number = to_float64(value)
    if _fit_float32([number]):
        return number
    raise MessageError("float32", describe(value))


def converter(name: str, max_length: int | None = None) -> Convert:
    if name in INTEGER_RANGES:
        return _integer_converter(name)
    if name in TEXTS:
        return _text_converter(name, max_length)
    return _CONVERTERS[name]


def element_converter(name: str, max_length: int | None = None) -> Convert:
    """Return the converter of an element of a list: as :func:`converter`, and true and false are numbers too.

    rosbridge_library passes a list of numbers on unchanged, and rclpy takes Python's truth values for integers.
    """
    convert = converter(name, max_length)
    if name == "bool" or name in TEXTS:
        return convert
    return lambda value: convert(int(value) if type(value) is bool else value)


@functools.lru_cache(maxsize=MAX_COMPILED_TYPES)
def list_converter(name: str, max_length: int | None = None) -> ConvertList:
    """Return the quick way for lists in which every element fits; it returns None for any other list."""
    # Infinities of 32 bits are beyond the bounds of the strict type.
    element = float if name == "float32" else strict_type(name, max_length)
    if element is None:
        return lambda _values: None
    # A struct, since msgspec keeps its types; it would read the types of a list alone each time.
    struct = msgspec.defstruct("Elements", [("elements", list[element])], array_like=True)  # type: ignore[valid-type]

    def to_elements(values: list[Any]) -> list[Any] | None:
        try:
            converted: list[Any] = msgspec.convert((values,), struct).elements  # type: ignore[attr-defined]
        except (msgspec.ValidationError, OverflowError):
            return None
        return converted if name != "float32" or _fit_float32(converted) else None

    return to_elements


def strict_type(name: str, max_length: int | None = None) -> Any:
    """Return the type by which msgspec takes a primitive that needs no conversion; None for unsigned 64 bits.

    msgspec takes no bounds beyond 64 bits with a sign.
    """
    if name in TEXTS:
        return str if max_length is None else Annotated[str, msgspec.Meta(max_length=max_length)]
    if name not in INTEGER_RANGES:
        return _STRICT_TYPES[name]
    lowest, highest = INTEGER_RANGES[name]
    return None if highest >= 1 << 63 else Annotated[int, msgspec.Meta(ge=lowest, le=highest)]


def to_list(values: list[Any], convert: Callable[[object], T]) -> list[T]:
    """Convert element by element; an error names the index."""
    converted = []
    for index, value in enumerate(values):
        try:
            converted.append(convert(value))
        except MessageError as error:
            # The chain of wrapped errors would show one fact once per level of nesting.
            raise error.inside(f"[{index}]") from None
    return converted


def to_octets(value: object, wanted: str) -> bytes:
    """Take octets as base64 text (standard alphabet, padded) or as a list of integers."""
    if isinstance(value, list):
        octets = _octet_list(value)
        return bytes(to_list(value, _octet) if octets is None else octets)
    if not isinstance(value, str):
        raise MessageError(f"{wanted} as base64 text or list", describe(value))
    try:
        # Without validation stray characters are skipped, and a text that is no base64 becomes octets. Encoders of
        # MIME break lines (RFC 2045, 6.8): Python's encodebytes, and Java's.
        return pybase64.b64decode(value.replace("\r", "").replace("\n", ""), validate=True)
    except ValueError as error:
        raise MessageError(f"{wanted} as base64 text", describe(value)) from error


def octets_in(text: str) -> int | None:
    """Count the octets in a text that is base64 as it goes out; None for any other text."""
    try:
        count = len(pybase64.b64decode(text, validate=True))
    except ValueError:
        return None
    # The last character may say more than the octets have; no decoder minds.
    padding = text[-2:].count("=")
    return count if not padding or text[-1 - padding] in _LAST_CHARACTERS[padding] else None


# Last characters of base64 text by the length of its padding (RFC 4648, 3.5: the unused bits are zero).
_LAST_CHARACTERS = {1: "AEIMQUYcgkosw048", 2: "AQgw"}


_CONVERTERS: dict[str, Convert] = {"bool": to_bool, "float32": to_float32, "float64": to_float64}


def _integer_converter(name: str) -> Callable[[object], int]:
    lowest, highest = INTEGER_RANGES[name]
    wanted = f"{name} ({lowest} to {highest})"

    def to_integer(value: object) -> int:
        # JavaScript and CBOR clients cannot tell 2 from 2.0; is_integer is false for NaN and infinity.
        number = int(value) if type(value) is float and value.is_integer() else value
        if type(number) is int and lowest <= number <= highest:
            return number
        raise MessageError(wanted, describe(value))

    return to_integer


def _fit_float32(numbers: list[float]) -> bool:
    try:
        # Only with a byte order given does struct refuse a number that is too large; else it stores infinity.
        struct.pack(f"<{len(numbers)}f", *numbers)
    except OverflowError:
        return False
    return True


def _text_converter(name: str, max_length: int | None) -> Callable[[object], str]:
    wanted = name if max_length is None else f"{name} of at most {max_length} characters"

    def to_text(value: object) -> str:
        if type(value) is not str:
            raise MessageError(wanted, describe(value))
        # Characters, as the Python classes of ROS 2 count them (rosidl_generator_py); DDS has no rule of its own.
        if max_length is not None and len(value) > max_length:
            raise MessageError(wanted, f"{len(value)}")
        return value

    return to_text


_octet = _integer_converter("uint8")
_octet_list = list_converter("uint8")
