"""Primitive values of a message: validates what came and converts it to what the type stores.

Every converter takes a decoded value and returns it as the type wants it, or raises MessageError. What is
forgiven: an integer for a float, a whole float for an integer, null for a float (NaN goes out as null, so
null comes back as NaN).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import pybase64

from protocol.errors import MessageError, describe

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

# What the elements of a list may be.
_ONLY_INT, _ONLY_FLOAT, _NUMBERS = frozenset((int,)), frozenset((float,)), frozenset((int, float))


def zero(name: str) -> Primitive:
    """Return the value of a primitive field that nobody set."""
    if name in INTEGER_RANGES:
        return 0
    if name == "bool":
        return False
    return "" if name == "string" else 0.0


def to_bool(value: object) -> bool:
    """Take true or false; a number is no truth value."""
    # Exact types throughout this module: isinstance would take a bool for an int, which a ROS field is not.
    if type(value) is bool:
        return value
    raise MessageError("bool", describe(value))


def to_string(value: object) -> str:
    """Take text."""
    if type(value) is str:
        return value
    raise MessageError("string", describe(value))


def to_float64(value: object) -> float:
    """Take a number or null."""
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


def converter(name: str) -> Convert:
    """Return the converter of a primitive type."""
    if name in INTEGER_RANGES:
        return _integer_converter(name)
    return _CONVERTERS[name]


def list_converter(name: str) -> ConvertList:
    """Return the quick way for lists in which every element is as it should be.

    The converter returned gives None for any other list: then the elements are looked at one by one, which is
    slower but finds what can be forgiven and the index of what cannot.
    """
    if name in INTEGER_RANGES:
        return _integer_list_converter(name)
    if name == "float32":
        return _floats32
    return _floats64 if name == "float64" else _same_type_list_converter({"bool": bool, "string": str}[name])


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
    """Take octets as base64 text (standard alphabet, padded, nothing around it) or as a list of integers.

    Args:
        value: what came.
        wanted: the field's type, for the error.
    """
    if isinstance(value, list):
        octets = _octet_list(value)
        return bytes(to_list(value, _octet) if octets is None else octets)
    if not isinstance(value, str):
        raise MessageError(f"{wanted} as base64 text or list", describe(value))
    try:
        # Without validation stray characters are skipped, and a text that is no base64 becomes octets.
        return pybase64.b64decode(value, validate=True)
    except ValueError as error:
        raise MessageError(f"{wanted} as base64 text", describe(value)) from error


def octets_text(octets: bytes) -> str:
    """Return octets as base64 text."""
    return pybase64.b64encode_as_string(octets)


def octets_in(text: str) -> int | None:
    """Count the octets in a text that is base64 as :func:`octets_text` writes it; None for any other text."""
    try:
        count = len(pybase64.b64decode(text, validate=True))
    except ValueError:
        return None
    # The last character may say more than the octets have; no decoder minds.
    padding = text[-2:].count("=")
    return count if not padding or text[-1 - padding] in _LAST_CHARACTERS[padding] else None


# Of base64 text, in front of so many characters of padding (RFC 4648, 3.5: the bits that are left over are zero).
_LAST_CHARACTERS = {1: "AEIMQUYcgkosw048", 2: "AQgw"}


_CONVERTERS: dict[str, Convert] = {
    "bool": to_bool,
    "string": to_string,
    "float32": to_float32,
    "float64": to_float64,
}


def _integer_converter(name: str) -> Callable[[object], int]:
    lowest, highest = INTEGER_RANGES[name]
    wanted = f"{name} ({lowest} to {highest})"

    def to_integer(value: object) -> int:
        """Take a whole number within the type's range."""
        # JavaScript and CBOR clients cannot tell 2 from 2.0; is_integer is false for NaN and infinity.
        number = int(value) if type(value) is float and value.is_integer() else value
        if type(number) is int and lowest <= number <= highest:
            return number
        raise MessageError(wanted, describe(value))

    return to_integer


def _integer_list_converter(name: str) -> ConvertList:
    lowest, highest = INTEGER_RANGES[name]

    def to_integers(values: list[Any]) -> list[Any] | None:
        """Take integers within the type's range."""
        # Sets of types, min and max run in C: less than half the time of a look at each element.
        if not _ONLY_INT.issuperset(map(type, values)):
            return None
        return values.copy() if not values or (lowest <= min(values) and max(values) <= highest) else None

    return to_integers


def _floats64(values: list[Any]) -> list[Any] | None:
    if _ONLY_FLOAT.issuperset(map(type, values)):
        return values.copy()
    try:
        # JavaScript writes the float 1.0 as 1, so a list of floats is seldom of one kind.
        return list(map(float, values)) if _NUMBERS.issuperset(map(type, values)) else None
    except OverflowError:
        return None


def _floats32(values: list[Any]) -> list[Any] | None:
    numbers = _floats64(values)
    return numbers if numbers is not None and _fit_float32(numbers) else None


def _fit_float32(numbers: list[float]) -> bool:
    try:
        # Only with a byte order given does struct refuse what is too large, rather than store infinity.
        struct.pack(f"<{len(numbers)}f", *numbers)
    except OverflowError:
        return False
    return True


def _same_type_list_converter(kind: type) -> ConvertList:
    only_kind = frozenset((kind,))

    def to_same_type(values: list[Any]) -> list[Any] | None:
        """Take values of exactly this type."""
        return values.copy() if only_kind.issuperset(map(type, values)) else None

    return to_same_type


_octet = _integer_converter("uint8")
_octet_list = _integer_list_converter("uint8")
