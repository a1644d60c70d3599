"""The bridge for a server that wants one, without a cost for those that do not."""

from __future__ import annotations

from typing import TYPE_CHECKING

from server.access.authorization import Access
from server.graph.topics import Graph
from server.zenoh.settings import ZenohSettings

if TYPE_CHECKING:
    from server.zenoh.bridge import Bridge


def bridge_of(settings: ZenohSettings, graph: Graph, access: Access, max_message_bytes: int) -> Bridge | None:
    """What shares topics and services with other machines; None when nothing is to be shared.

    Args:
        settings: the section ``zenoh``.
        graph: what is shared.
        access: what others may do.
        max_message_bytes: of what comes from them [bytes].

    Raises:
        ConfigurationError: zenoh is not installed, or cannot be configured so.
    """
    if settings.mode == "off":
        return None
    # Imported when it is needed: most servers share nothing, and few have zenoh installed.
    from server.zenoh.bridge import Bridge

    return Bridge(graph, settings, access, max_message_bytes)
