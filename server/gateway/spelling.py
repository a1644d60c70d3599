"""How one client spells messages: ROS 2 or ROS 1, and with octets where its frames can carry them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocol import dialect
from protocol.codecs import arrays
from protocol.dialect import Dialect
from protocol.registry import Kind, Registry
from protocol.session import Session

# Clients of both generations call rosapi's types so.
_ROSAPI = "rosapi/"


class Spelling:
    """Translates between a client and the graph, in which messages are in ROS 2 spelling.

    Args:
        session: the client's; holds its dialect.
        registry: types.
    """

    def __init__(self, session: Session, registry: Registry) -> None:
        self._session = session
        self._registry = registry

    @property
    def dialect(self) -> Dialect:
        """Which generation of ROS the client speaks."""
        return self._session.dialect

    def learn(self, type_name: object, kind: Kind) -> None:
        """Take the client for one of ROS 1 when it names a type that only ROS 1 has."""
        if (
            isinstance(type_name, str)
            and not type_name.startswith(_ROSAPI)
            and self._registry.exists_only_in_ros1(type_name, kind)
        ):
            self._session.dialect = "ros1"

    def to_client(self, type_name: str, msg: Mapping[str, Any]) -> Mapping[str, Any]:
        """Spell a complete message for the client, as part of a reply.

        Args:
            type_name: canonical name of a message type or of a member of a service or action.
            msg: the message; it is left as it was.
        """
        if not self._registry.knows(type_name):
            return msg
        if self._session.speaks_bson:
            msg = arrays.with_octets(self._registry, type_name, msg)
        return dialect.to_ros1(self._registry, type_name, msg) if self._session.dialect == "ros1" else msg

    def from_client(self, type_name: str | None, value: object) -> object:
        """Spell what the client sent as ROS 2 does, to be validated.

        Args:
            type_name: as for :meth:`to_client`, None when it is not known.
            value: the message as it was decoded.
        """
        if self._session.dialect == "ros2" or type_name is None or not self._registry.knows(type_name):
            return value
        return dialect.from_ros1(self._registry, type_name, value)
