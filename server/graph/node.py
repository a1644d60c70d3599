"""Participants of the graph."""

from dataclasses import dataclass, field

from server.graph.permissions import ANYONE, Identity, Role


@dataclass(eq=False, repr=False)
class Node:
    """Participant in the graph: a client (``remote``), or a part of the server, whose names no client may take."""

    name: str
    remote: bool = field(default=False, kw_only=True)
    takes_goals_along: bool = field(default=False, kw_only=True)  # True to cancel its goals when it leaves
    identity: Identity | None = field(default=ANYONE, kw_only=True)  # None until a client has authenticated
    address: str = field(default="", kw_only=True)

    @property
    def is_viewer(self) -> bool:
        """True for a client that moves and changes nothing by itself, and for a client without an identity yet."""
        return self.identity is None or self.identity.role < Role.OPERATE

    def __repr__(self) -> str:
        return self.name
