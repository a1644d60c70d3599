"""Notifications of systemd, as sd_notify(3) for a service of type notify."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import MutableMapping

log = logging.getLogger("armbridge.monitoring")

# Names of abstract sockets begin with a zero byte, written as "@" in the environment (sd_notify(3)).
_ABSTRACT = "@"

_US_PER_S = 1_000_000


class SystemdNotifier:
    """Sends notifications to systemd's datagram socket; after ``watchdog_s`` of silence systemd ends the server."""

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s if address else 0.0
        # None without systemd, and once closed.
        self._socket = _connected(address) if address else None

    @classmethod
    def from_environment(
        cls, environment: MutableMapping[str, str] = os.environ, pid: int | None = None
    ) -> SystemdNotifier:
        """Return the notifier for the socket in the environment, without which children notify nobody."""
        address = environment.pop("NOTIFY_SOCKET", "")
        watchdog_us = environment.pop("WATCHDOG_USEC", "")
        watchdog_pid = environment.pop("WATCHDOG_PID", "")
        watched = watchdog_us.isdecimal() and watchdog_pid in ("", str(os.getpid() if pid is None else pid))
        return cls(address, int(watchdog_us) / _US_PER_S if watched else 0.0)

    def notify_ready(self) -> None:
        self._send("READY=1")

    def notify_watchdog(self) -> None:
        self._send("WATCHDOG=1")

    def notify_stopping(self) -> None:
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, assignment: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(assignment.encode())
        except OSError as error:
            log.debug("systemd cannot be notified: %s", error)


def _connected(address: str) -> socket.socket | None:
    path = "\0" + address[1:] if address.startswith(_ABSTRACT) else address
    connecting = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        connecting.connect(path)
    except (OSError, ValueError) as error:
        connecting.close()
        log.warning("NOTIFY_SOCKET: %s cannot be reached: %s", address, error)
        return None
    return connecting
