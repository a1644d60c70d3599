"""The sockets that clients connect to: every address of the host, on one port."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Sequence
from typing import NamedTuple

from server.errors import StartError

# Connections that wait to be accepted; a flood of one client's must not keep another's out of the queue.
BACKLOG = 1024

# Port 0 takes a free one of the first address, which another program may have on the next.
FREE_PORT_TRIES = 5

# The address is not there on this machine: without IPv6, ``localhost`` is 127.0.0.1 alone.
_NOT_HERE = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


class Place(NamedTuple):
    """Where to listen: what :func:`socket.socket` and ``bind`` take."""

    family: socket.AddressFamily
    address: str
    scope_id: int


async def resolve(host: str, port: int) -> list[Place]:
    """The addresses of a host.

    Args:
        host: a name or an address; empty for every address of this machine.
        port: TCP port, for the refusal.

    Raises:
        StartError: it has none.
    """
    try:
        found = await asyncio.get_running_loop().getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
    # A name that no domain could have is refused before anybody is asked for it.
    except (OSError, UnicodeError) as error:
        raise StartError(_reason(host, port, error)) from error
    places = [
        Place(family, str(address[0]), int(address[3]) if len(address) > 3 else 0) for family, _, _, _, address in found
    ]
    return list(dict.fromkeys(places))


def listen(places: Sequence[Place], host: str, port: int) -> list[socket.socket]:
    """Take a port on every address that this machine has.

    Args:
        places: where, at least one.
        host: what they were found for, for the refusal.
        port: TCP port; 0 takes a free one, the same on all.

    Raises:
        StartError: the port is in use, not allowed, or none of the addresses is ours.
    """
    for tries_left in reversed(range(FREE_PORT_TRIES)):
        try:
            return _listen_on_all(places, port)
        except OSError as error:
            if port or error.errno != errno.EADDRINUSE or not tries_left:
                raise StartError(_reason(host, port, error)) from error
    raise AssertionError("no try was the last")


def _listen_on_all(places: Sequence[Place], port: int) -> list[socket.socket]:
    listening: list[socket.socket] = []
    missing: OSError | None = None
    for place in places:
        try:
            listening.append(_listen_on(place, port, alone=len(places) == 1))
        except OSError as error:
            if error.errno not in _NOT_HERE:
                _close(listening)
                raise
            missing = error
        else:
            port = listening[0].getsockname()[1]
    if not listening:
        raise missing or OSError(errno.EADDRNOTAVAIL, "no address")
    return listening


def _listen_on(place: Place, port: int, *, alone: bool) -> socket.socket:
    # With the protocol named, asyncio takes what is accepted for TCP, and sends small messages at once.
    made = socket.socket(place.family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if place.family == socket.AF_INET6:
            # Beside a socket for IPv4 it must leave that alone; by itself, ``::`` is for both.
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, not alone)
            made.bind((place.address, port, 0, place.scope_id))
        else:
            made.bind((place.address, port))
        made.listen(BACKLOG)
        made.setblocking(False)
    except OSError:
        made.close()
        raise
    return made


def _close(sockets: Sequence[socket.socket]) -> None:
    for each in sockets:
        each.close()


def _reason(host: str, port: int, error: OSError | UnicodeError) -> str:
    where = f"{host}:{port}"
    if isinstance(error, UnicodeError):
        return f"cannot listen on {where}: this is no name of a host"
    if error.errno == errno.EADDRINUSE:
        return f"port in use: {where} is taken by another program; choose one with --port"
    return f"cannot listen on {where}: {error.strerror or error}"
