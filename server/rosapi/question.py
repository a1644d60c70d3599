"""What rosapi is asked: a request, and the generation of ROS in whose words it is answered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

from protocol.dialect import Dialect, spell_type
from protocol.names import qualify


class Question(NamedTuple):
    """One request.

    Attributes:
        request: the complete request message.
        dialect: what the caller speaks; names of types in the answer are spelled so.
    """

    request: Mapping[str, Any]
    dialect: Dialect

    def name(self, field: str) -> str:
        """Return the fully qualified name in a field of the request."""
        return qualify(self.request[field])

    def spell(self, type_name: str) -> str:
        """Spell the canonical name of a type, or the empty text that stands for none, for the caller."""
        return spell_type(type_name, self.dialect)

    def spell_all(self, type_names: Iterable[str]) -> list[str]:
        """Spell canonical names of types."""
        return [spell_type(type_name, self.dialect) for type_name in type_names]


# Response fields; where there is no answer it raises ServiceError.
Answer: TypeAlias = Callable[[Question], dict[str, Any]]

# Service name below /rosapi -> its type, and what answers it.
Answers: TypeAlias = Mapping[str, tuple[str, Answer]]


def of_type(types: Mapping[str, str], wanted: str) -> list[str]:
    """Return the names whose type is this one, in alphabetical order; none for a type nobody knows.

    Args:
        types: canonical type of each name.
        wanted: a type in the spelling of either generation.
    """
    # The spelling of ROS 1 is the one that both can be brought to.
    spelled = spell_type(wanted, "ros1")
    return sorted(name for name, type_name in types.items() if spell_type(type_name, "ros1") == spelled)
