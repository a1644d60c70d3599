"""Who takes part in the network, by the liveliness tokens of rmw_zenoh; those who vanish take theirs along."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

from server.zenoh.keys import ADMIN_SPACE, Entity, read

if TYPE_CHECKING:
    import zenoh

# Far more than a few robots share; keeps one that invents tokens from growing the server.
MAX_ENTITIES = 1_000


class Discovery:
    """All others that matter, kept up to date by zenoh's threads and looked at by the event loop.

    Args:
        domain_id: ROS_DOMAIN_ID.
        session: id of this server's session, which is left out.
        concerns: whether somebody matters; called in zenoh's threads.
    """

    def __init__(self, domain_id: int, session: str, concerns: Callable[[Entity], bool]) -> None:
        self._domain_id = domain_id
        self._session = session
        self._concerns = concerns
        self._lock = threading.Lock()
        self._entities: dict[str, Entity] = {}
        self._told: tuple[Entity, ...] | None = ()

    def open(self, session: zenoh.Session) -> None:
        """Begin to listen, in the thread of the session; those who are there already come first."""
        import zenoh

        handler = zenoh.handlers.Callback(self._on_token, indirect=False)
        session.liveliness().declare_subscriber(f"{ADMIN_SPACE}/{self._domain_id}/**", handler, history=True)

    def entities(self) -> tuple[Entity, ...]:
        """All that is there now, each once; the same object for as long as nothing changes."""
        with self._lock:
            if self._told is None:
                self._told = tuple(dict.fromkeys(self._entities.values()))
            return self._told

    def _on_token(self, sample: zenoh.Sample) -> None:
        import zenoh

        self.take(str(sample.key_expr), alive=sample.kind == zenoh.SampleKind.PUT)

    def take(self, token: str, *, alive: bool) -> None:
        """Note that somebody has come or gone."""
        entity = read(token) if alive else None
        is_other = entity is not None and entity.session != self._session and self._concerns(entity)
        with self._lock:
            if entity is not None and is_other and len(self._entities) < MAX_ENTITIES:
                self._entities[token] = entity
                self._told = None
            elif not alive and self._entities.pop(token, None) is not None:
                self._told = None
