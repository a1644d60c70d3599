"""Participants of the graph."""

from __future__ import annotations

from server.graph.permissions import ANYONE, Identity, Role


class Node:
    """Anyone who publishes, subscribes, offers or calls: a connection, or a part of the server.

    Args:
        remote: whether it is a client, which may not take the place of a part of the server.
        takes_goals_along: whether the goals that it has sent to actions are cancelled when it leaves.
        identity: who it is; None for a client that has yet to say so.
    """

    def __init__(
        self,
        name: str,
        *,
        remote: bool = False,
        takes_goals_along: bool = False,
        identity: Identity | None = ANYONE,
        address: str = "",
    ) -> None:
        self.name = name
        self.remote = remote
        self.takes_goals_along = takes_goals_along
        self.identity = identity
        self.address = address

    @property
    def is_viewer(self) -> bool:
        """True for a client that moves and changes nothing by itself, and for a client without an identity yet."""
        return self.identity is None or self.identity.role < Role.OPERATE

    def __repr__(self) -> str:
        return self.name
