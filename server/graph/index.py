"""Indexes of the graph: items by their key, and names in use with their types.

They let a look-up cost what it returns, however many topics, offers and requests of others there are.
"""

from collections.abc import Iterator
from typing import Generic, TypeVar

from protocol.dialect import Dialect, spell_type

Key = TypeVar("Key")
Item = TypeVar("Item")


class Index(Generic[Key, Item]):
    """Items by key, in the order in which they came; a key without items takes no place."""

    def __init__(self) -> None:
        # Dicts in place of sets, for their order.
        self._items: dict[Key, dict[Item, None]] = {}

    def __iter__(self) -> Iterator[Key]:
        return iter(self._items)

    def add(self, key: Key, item: Item) -> None:
        """Enter an item under a key; nothing happens when it is there."""
        self._items.setdefault(key, {})[item] = None

    def discard(self, key: Key, item: Item) -> None:
        """Take an item away from a key; nothing happens when it is not there."""
        items = self._items.get(key)
        if items is not None:
            items.pop(item, None)
            if not items:
                del self._items[key]

    def of(self, key: Key) -> list[Item]:
        """Return the items of a key; the index may change meanwhile."""
        return list(self._items.get(key, ()))

    def count(self, key: Key) -> int:
        return len(self._items.get(key, ()))


def is_hidden(name: str) -> bool:
    """Return True for a name that ROS 2 leaves out of lists: a part of it begins with an underscore."""
    return "/_" in name


class TypedNames:
    """Names in use of one kind, such as topics, each with its type; ``revision`` counts the changes."""

    def __init__(self) -> None:
        self.revision = 0
        self._types: dict[str, str] = {}
        self._hidden: set[str] = set()
        # Every spelling of a type can be converted to ROS 1's.
        self._by_type: Index[str, str] = Index()

    def __len__(self) -> int:
        return len(self._types)

    def add(self, name: str, type_name: str) -> None:
        """Enter a fully qualified name that is not there, with the canonical name of its type."""
        self._types[name] = type_name
        if is_hidden(name):
            self._hidden.add(name)
        self._by_type.add(spell_type(type_name, "ros1"), name)
        self.revision += 1

    def remove(self, name: str) -> None:
        """Take a name away that is there."""
        self._by_type.discard(spell_type(self._types.pop(name), "ros1"), name)
        self._hidden.discard(name)
        self.revision += 1

    def type_of(self, name: str, dialect: Dialect = "ros2") -> str | None:
        """Return the type of a fully qualified name, spelled in a dialect; None for a name that is not in use."""
        type_name = self._types.get(name)
        return None if type_name is None else spell_type(type_name, dialect)

    def types(self, dialect: Dialect = "ros2") -> dict[str, str]:
        """Return the type of every name, spelled in a dialect."""
        if dialect == "ros2":
            return self._types.copy()
        spelled = {each: spell_type(each, dialect) for each in set(self._types.values())}
        return {name: spelled[type_name] for name, type_name in self._types.items()}

    def shown_types(self, dialect: Dialect = "ros2") -> dict[str, str]:
        """Return the type of every name that is not hidden; of 10,000 names, to look at each takes a millisecond."""
        types = self.types(dialect)
        for name in self._hidden:
            del types[name]
        return types

    def of_type(self, type_name: str) -> list[str]:
        """Return the names that have a type, in order of entry; none for an unknown type."""
        return self._by_type.of(spell_type(type_name, "ros1"))
