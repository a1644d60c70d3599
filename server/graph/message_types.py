"""The types of what goes through the graph: looks them up, and completes messages of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from protocol import messages
from protocol.errors import InterfaceError, MessageError, describe
from protocol.messages import Stamp
from protocol.registry import Kind, Registry


class MessageTypes:
    """Types and messages, of whoever publishes or calls.

    Args:
        registry: the known types.
        wall_clock: seconds since the epoch, for stamps.
        relay_unknown_types: take types that the registry does not know, and leave their messages as they are.
    """

    def __init__(
        self,
        registry: Registry,
        wall_clock: Callable[[], float] = time.time,
        *,
        relay_unknown_types: bool = False,
    ) -> None:
        self.registry = registry
        self._wall_clock = wall_clock
        self._relay_unknown_types = relay_unknown_types

    def canonical(self, name: str, kind: Kind) -> str:
        """Return the three-part name of a type.

        Raises:
            InterfaceError: no such type, and unknown ones are not relayed.
        """
        try:
            return self.registry.canonical(name, kind)
        except InterfaceError:
            parts = name.split("/")
            if not self._relay_unknown_types or len(parts) not in (2, 3):
                raise
            return f"{parts[0]}/{kind}/{parts[-1]}"

    def now(self) -> Stamp:
        """Return the time of receipt of what comes now."""
        return Stamp.from_seconds(self._wall_clock())

    def complete(self, type_name: str, value: object, received: Stamp | None = None) -> dict[str, Any]:
        """Validate a message and fill in what it leaves out; see `protocol.messages.complete`.

        Args:
            type_name: canonical name of a message type, or of a member such as ``std_srvs/srv/SetBool_Request``.
            value: the message.
            received: when it came, None for now.

        Raises:
            MessageError: the value does not fit the type.
        """
        try:
            return messages.complete(self.registry, type_name, value, received or self.now())
        except InterfaceError:
            # Only types that `canonical` let through get here: nothing is known that could be checked.
            if not isinstance(value, dict):
                raise MessageError(type_name, describe(value)) from None
            return value

    def complete_arguments(self, type_name: str, arguments: object) -> dict[str, Any]:
        """Complete a request or a goal, given as rosbridge's ``args``.

        Args:
            type_name: as for :meth:`complete`.
            arguments: fields by name or in order of declaration; anything else stands for no fields.

        Raises:
            MessageError: the arguments do not fit the type.
        """
        if isinstance(arguments, list):
            return self.complete(type_name, self._by_name(type_name, arguments))
        return self.complete(type_name, arguments if isinstance(arguments, dict) else {})

    def _by_name(self, type_name: str, arguments: list[Any]) -> dict[str, Any]:
        try:
            names = [field.name for field in self.registry.message(type_name).fields]
        except InterfaceError:
            raise MessageError(f"{type_name} as an object", describe(arguments)) from None
        if len(arguments) > len(names):
            raise MessageError(f"at most {len(names)} arguments ({', '.join(names)})", f"{len(arguments)}")
        return dict(zip(names, arguments, strict=False))
