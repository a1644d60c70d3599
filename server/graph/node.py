"""Participants of the graph."""

from server.graph.permissions import ANYONE, Identity, Role


class Node:
    """Participant in the graph: a client (``remote``), or a part of the server, whose names no client may take.

    ``takes_goals_along`` cancels its goals when it leaves; ``identity`` is None until a client has authenticated.
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
