"""Which topics and services are shared, and what they are called on either side."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Iterable

from server.zenoh.keys import is_name

# Names that have been looked at once; all names of a large robot, and twice a second all of them are asked for.
MAX_KNOWN = 10_000


class Patterns:
    """Names by patterns, of which one must fit; without any, none fits.

    Args:
        patterns: ``*`` stands for any text, also with slashes in it, as in the globs of ``access``.
        along: which further names are meant as soon as there is a pattern at all.
    """

    def __init__(self, patterns: Iterable[str], along: Callable[[str], bool] = lambda _name: False) -> None:
        self._expressions = [re.compile(fnmatch.translate(pattern)) for pattern in patterns]
        self._along = along
        self._known: dict[str, bool] = {}

    def fit(self, name: str) -> bool:
        """Whether a name is meant, and can be the name of something shared."""
        known = self._known.get(name)
        if known is None:
            if len(self._known) >= MAX_KNOWN:
                self._known.clear()
            known = self._known[name] = self._look(name)
        return known

    def _look(self, name: str) -> bool:
        if not self._expressions or not is_name(name):
            return False
        return self._along(name) or any(expression.match(name) for expression in self._expressions)


class Namespace:
    """The namespace that this server's names have at the others.

    Args:
        namespace: with a slash before it, or empty.
    """

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace

    def outside(self, name: str) -> str:
        """What a name of this server is called at the others."""
        return f"{self._namespace}{name}"

    def inside(self, name: str) -> str:
        """What a name at the others is called in this server; names of other namespaces stay as they are."""
        return name[len(self._namespace) :] if self.has(name) else name

    def has(self, name: str) -> bool:
        """Whether a name at the others is in this server's namespace."""
        return name.startswith(f"{self._namespace}/")
