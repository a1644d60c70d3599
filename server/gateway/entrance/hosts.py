"""The names under which the server may be addressed.

A page of another host can have its own name point to the server's address (DNS rebinding), and is then of one origin
with the server for its browser. The name still stands in the ``Host`` header of each of its requests.
"""

from __future__ import annotations

import socket
from collections.abc import Iterable, Sequence

from server.gateway.entrance.addresses import Authority, matches


class Hosts:
    """Which hosts are the server itself.

    IP addresses are, whichever they are: no name was resolved that someone else could turn elsewhere.

    Args:
        allowed: more names, as ``access.allowed_hosts`` has them: with a port or without, ``*`` for any text.
        own: names of this machine.
    """

    def __init__(self, allowed: Iterable[str] = (), own: Iterable[str] = ()) -> None:
        self._allowed = tuple(each.lower() for each in allowed)
        self._own = frozenset(("localhost", *own))

    def has(self, host: Authority) -> bool:
        """Whether a host is the server."""
        if host.address is not None or host.host in self._own:
            return True
        names = (host.host, f"{host.host}:{host.port}")
        return any(matches(name, pattern) for pattern in self._allowed for name in names)


def own_names(hostname: str | None = None) -> Sequence[str]:
    """The names of this machine that need nobody's answer: its hostname, and the one that multicast DNS has for it.

    Args:
        hostname: how it is called; None asks the system.
    """
    name = (socket.gethostname() if hostname is None else hostname).lower()
    short = name.partition(".")[0]
    return (name, short, f"{short}.local") if short else ()
