"""Globs: which names clients may use, as rosbridge_server's parameters of the same names say it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import translate


class Globs:
    """Patterns of names.

    Args:
        setting: where they are set, for refusals.
        patterns: as of a shell: ``*`` is any text, also with slashes; none at all fit every name.
        always: further names that fit when there are patterns.
    """

    def __init__(self, setting: str, patterns: Iterable[str] = (), always: Iterable[str] = ()) -> None:
        self._setting = setting
        wanted = [*patterns]
        self._fits = re.compile("|".join(translate(each) for each in (*wanted, *always))) if wanted else None

    def refusal(self, kind: str, name: str) -> str | None:
        """Why a name may not be used; None when it may.

        Args:
            kind: of what is named, for the sentence.
            name: fully qualified.
        """
        if self._fits is None or self._fits.match(name):
            return None
        return f"{kind} {name}: fits no pattern of {self._setting}; add one there to open it"
