"""The quick way for a message in which each value is of its field's type; fields may be left out.

Most messages are so, and `protocol.messages`, which knows all that is forgiven and all that is refused, walks a tree of
objects for them as well. Here each type becomes one function without calls, as a person would write it by hand for
this type: of `geometry_msgs/msg/Point32` it reads ::

    def quick(v0):
        try:
            if type(v0) is not dict: return None
            if len(v0) != 3 and len(v0 := {**defaults_0, **v0}) != 3: return None
            v1 = v0['x']
            ...
            return {'x': v1, 'y': v2, 'z': v3}
        except (KeyError, OverflowError):
            return None

What it returns None for goes the long way, so there is one place for each rule and one for each error's text.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any, TypeAlias

from protocol import values
from protocol.message_budget import BUDGET, values_in
from protocol.registry import ArrayBounds, Field, MessageType, Registry

# Returns the message anew, or None where it is not as it should be in every respect.
Quick: TypeAlias = Callable[[object], dict[str, Any] | None]

# As many as there are compiled types in protocol.messages.
_MAX_COMPILED_TYPES = 1024

# The largest finite number of IEEE 754 single precision.
_FLOAT32_MAX = 3.4028234663852886e38

# The stamp of a header that has none is the time of receipt.
_HEADER = "std_msgs/msg/Header"

# Arrays of these are base64 text or a list, and are spelled anew.
_OCTETS = ("uint8", "char", "byte")


@functools.lru_cache(maxsize=_MAX_COMPILED_TYPES)
def quick_way(registry: Registry, type_name: str) -> Quick:
    """Return the function of a message type; for a type with arrays of octets it takes no message at all.

    Raises:
        InterfaceError: the type is unknown.
    """
    writer = _Writer(registry)
    copy = writer.message("v0", registry.message(type_name))
    return writer.compiled(copy) if writer.possible else _nothing


def _nothing(_value: object) -> None:
    """Take no message."""


def _defaults(registry: Registry, message_type: MessageType) -> dict[str, Any]:
    """What stands in for fields that are left out, except where that depends on the time of receipt or its spelling."""
    defaults: dict[str, Any] = {}
    for field in message_type.fields:
        if field.base in _OCTETS and field.array is not None:
            continue
        value: Any
        if field.primitive:
            value = values.zero(field.base) if field.default is None else field.default
        elif message_type.name == _HEADER:
            continue
        else:
            part = registry.message(field.base)
            value = _defaults(registry, part)
            if len(value) != len(part.fields) and (field.array is None or field.array.min_length):
                continue
        defaults[field.name] = value if field.array is None else [value] * field.array.min_length
    return defaults


class _Writer:
    """Writes the source text of one type's function.

    Every method writes the checks of a value that stands in a variable, and returns the expression for its copy.

    Attributes:
        possible: whether the type has a quick way at all.
    """

    def __init__(self, registry: Registry) -> None:
        self.possible = True
        self._registry = registry
        self._lines: list[str] = []
        self._numbers = itertools.count(1)
        # What the function calls, by the names that it has there.
        self._names: dict[str, Any] = {}

    def message(self, variable: str, message_type: MessageType) -> str:
        """A message with its fields, and those of the messages in it."""
        count, defaults = len(message_type.fields), f"defaults_{variable}"
        self._names[defaults] = _defaults(self._registry, message_type)
        self._refuse_if(f"type({variable}) is not dict")
        # What is filled in is no part of what is returned, which is made anew of each value.
        self._refuse_if(f"len({variable}) != {count} and len({variable} := {{**{defaults}, **{variable}}}) != {count}")
        copies = []
        for field in message_type.fields:
            member = f"v{next(self._numbers)}"
            self._lines.append(f"{member} = {variable}[{field.name!r}]")
            copies.append(f"{field.name!r}: {self._field(member, field)}")
        return "{" + ", ".join(copies) + "}"

    def compiled(self, copy: str) -> Quick:
        """Make the function of what was written, which returns this expression."""
        body = "\n  ".join([*self._lines, f"return {copy}"])
        source = f"def quick(v0):\n try:\n  {body}\n except (KeyError, OverflowError):\n  return None"
        # Made of the interface tables alone, nothing that a client says is in it.
        exec(compile(source, "<quick way of a message type>", "exec"), self._names)  # noqa: S102
        quick: Quick = self._names["quick"]
        return quick

    def _field(self, variable: str, field: Field) -> str:
        if field.array is not None:
            return self._array(variable, field, field.array)
        if not field.primitive:
            return self.message(variable, self._registry.message(field.base))
        return self._primitive(variable, field.base)

    def _array(self, variable: str, field: Field, bounds: ArrayBounds) -> str:
        if field.base in _OCTETS:
            self.possible = False
        self._refuse_if(f"type({variable}) is not list")
        if bounds.max_length is not None:
            self._refuse_if(f"not {bounds.min_length} <= len({variable}) <= {bounds.max_length}")
        convert = "convert_" + field.base.replace("/", "_")
        if field.primitive:
            self._names[convert] = values.list_converter(field.base)
            self._lines.append(f"{variable} = {convert}({variable})")
            self._refuse_if(f"{variable} is None")
        else:
            self._names[convert] = quick_way(self._registry, field.base)
            self._names["take"] = BUDGET.take
            self._lines.append(f"take(len({variable}) * {values_in(self._registry, field.base)})")
            self._lines.append(f"{variable} = [{convert}(element) for element in {variable}]")
            self._refuse_if(f"None in {variable}")
        return variable

    def _primitive(self, variable: str, base: str) -> str:
        if base in values.INTEGER_RANGES:
            lowest, highest = values.INTEGER_RANGES[base]
            self._refuse_if(f"type({variable}) is not int or not {lowest} <= {variable} <= {highest}")
        elif base.startswith("float"):
            # JavaScript writes the float 1.0 as 1.
            self._lines.append(f"if type({variable}) is int: {variable} = float({variable})")
            self._refuse_if(f"type({variable}) is not float")
            if base == "float32":
                self._refuse_if(f"not -{_FLOAT32_MAX} <= {variable} <= {_FLOAT32_MAX}")
        else:
            self._refuse_if(f"type({variable}) is not {'str' if base == 'string' else 'bool'}")
        return variable

    def _refuse_if(self, condition: str) -> None:
        self._lines.append(f"if {condition}: return None")
