"""How many sockets the operating system lets the server have."""

from __future__ import annotations

import logging
import resource

log = logging.getLogger("armbridge.gateway")

# Besides the clients: planners, the bus, files.
SPARE = 256


def make_room_for(max_clients: int) -> None:
    """Raise this process's limit of open files as far as it may, and tell when that is not enough.

    Args:
        max_clients: connections that there may be.
    """
    wanted = max_clients + SPARE
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft >= wanted or soft == resource.RLIM_INFINITY:
        return
    possible = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (possible, hard))
    if possible < wanted:
        log.warning(
            "the system lets the server open %d files, which is enough for %d clients, not for server.max_clients = %d;"
            " raise the hard limit (ulimit -Hn, LimitNOFILE=), or lower the setting",
            possible,
            max(0, possible - SPARE),
            max_clients,
        )
