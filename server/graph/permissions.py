"""Roles of clients, their identities, and the filters of names that hold for all of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from fnmatch import translate


class Role(IntEnum):
    """Rights of a client; each role has those of the ones before it.

    VIEW reads, plans and stops; OPERATE moves the arm and changes the scene; ADMIN configures.
    """

    VIEW = 1
    OPERATE = 2
    ADMIN = 3


@dataclass(frozen=True)
class Identity:
    """Name and role of a client.

    Attributes:
        name: name of the token that it has shown; empty for a client that has shown none.
        role: its rights.
    """

    name: str
    role: Role

    @property
    def by_token(self) -> bool:
        """True for a client that has shown a token."""
        return bool(self.name)


# Every client of a server without tokens.
ANYONE = Identity("", Role.ADMIN)


def display_name(identity: Identity | None, address: str) -> str:
    """Return the name of a client in logs and in answers to others.

    Args:
        identity: None for a client that has yet to authenticate.
        address: address and port that it connects from.
    """
    return f"{identity.name} ({address})" if identity is not None and identity.by_token else f"client {address}"


class NameFilter:
    """Patterns of names that clients may use, as rosbridge_server's parameters ``topics_glob`` and its like.

    Args:
        setting: name of the setting, for refusals.
        patterns: patterns as of a shell: ``*`` is any text, also with slashes; without any pattern every name passes.
        always: further patterns that count once there are any.
    """

    def __init__(self, setting: str, patterns: Iterable[str] = (), always: Iterable[str] = ()) -> None:
        self._setting = setting
        wanted = [*patterns]
        self._pattern = re.compile("|".join(translate(each) for each in (*wanted, *always))) if wanted else None

    def refusal(self, kind: str, name: str) -> str | None:
        """Return the reason why a name may not be used, None when it may.

        Args:
            kind: topic, service, action or parameter, for the sentence.
            name: fully qualified.
        """
        if self._pattern is None or self._pattern.match(name):
            return None
        return f"{kind} {name}: fits no pattern of {self._setting}; add one there to open it"
