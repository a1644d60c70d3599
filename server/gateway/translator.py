"""Translation of messages between the graph and one client: ROS 2 or ROS 1, and octets where its frames carry them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocol import dialect
from protocol.codecs import cbor
from protocol.dialect import Dialect
from protocol.registry import Kind, Registry
from protocol.session import Session

# Clients of both generations call rosapi's types so.
_ROSAPI = "rosapi/"


class MessageTranslator:
    """Translator between one client and the graph, whose messages are in the dialect of ROS 2.

    Args:
        session: session of the client, with its dialect.
        registry: message types.
    """

    def __init__(self, session: Session, registry: Registry) -> None:
        self._session = session
        self._registry = registry

    @property
    def dialect(self) -> Dialect:
        """Dialect of the client."""
        return self._session.dialect

    def detect_dialect(self, type_name: object, kind: Kind) -> None:
        """Set the dialect to ROS 1 when the client names a type that exists only there."""
        if (
            isinstance(type_name, str)
            and not type_name.startswith(_ROSAPI)
            and self._registry.exists_only_in_ros1(type_name, kind)
        ):
            self._session.dialect = "ros1"

    def to_client(self, type_name: str, msg: Mapping[str, Any]) -> Mapping[str, Any]:
        """Translate a complete message for the client, as part of a reply.

        Args:
            type_name: canonical name of a message type or of a member of a service or action.
            msg: the message; it is not changed.
        """
        if not self._registry.knows(type_name):
            return msg
        if self._session.speaks_bson:
            msg = cbor.with_octets(self._registry, type_name, msg)
        return dialect.to_ros1(self._registry, type_name, msg) if self._session.dialect == "ros1" else msg

    def from_client(self, type_name: str | None, value: object) -> object:
        """Translate a message of the client to the dialect of ROS 2, to be validated.

        Args:
            type_name: as for :meth:`to_client`, None when it is not known.
            value: the message as it was decoded.
        """
        if self._session.dialect == "ros2" or type_name is None or not self._registry.knows(type_name):
            return value
        return dialect.from_ros1(self._registry, type_name, value)
