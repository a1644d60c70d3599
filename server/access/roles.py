"""What clients may do, in steps, and who they are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Role(IntEnum):
    """What a client may do; each may do what the ones before it may.

    VIEW reads, plans and stops; OPERATE moves the arm and changes the scene; ADMIN configures.
    """

    VIEW = 1
    OPERATE = 2
    ADMIN = 3


@dataclass(frozen=True)
class Identity:
    """Who a client is.

    Attributes:
        name: of the token that it has shown; empty for one that has shown none.
        role: what it may do.
    """

    name: str
    role: Role

    @property
    def by_token(self) -> bool:
        """Whether it has shown a token."""
        return bool(self.name)


def called(identity: Identity | None, address: str) -> str:
    """How logs and others call a client.

    Args:
        identity: who it is; None when that is not known yet.
        address: where it connects from.
    """
    return f"{identity.name} ({address})" if identity is not None and identity.by_token else f"client {address}"


# Whoever comes to a server without tokens.
ANYONE = Identity("", Role.ADMIN)
