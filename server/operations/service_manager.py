"""What systemd is told of a service of type notify (sd_notify): ready, stopping, its status, and that it is alive."""

from __future__ import annotations

import logging
import os
import socket
from collections import deque
from collections.abc import MutableMapping

log = logging.getLogger("armbridge.operations")

# Names of sockets that are in no file system begin with a zero byte, written as "@" in the environment.
_ABSTRACT = "@"

_US_PER_S = 1_000_000

# What is kept for one that does not read; the newest counts.
MAX_UNSENT = 8


class ServiceManager:
    """Who started the server, if it wants to be told; else nothing is done.

    Args:
        address: of its datagram socket; empty for nobody.
        watchdog_s: silence after which it ends the server [s]; 0 for never.
    """

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        self.watchdog_s = watchdog_s if address else 0.0
        self._unsent: deque[bytes] = deque(maxlen=MAX_UNSENT)
        self._socket: socket.socket | None = None
        if address:
            self._socket = _connected(address)

    @classmethod
    def of_environment(cls, environment: MutableMapping[str, str], pid: int) -> ServiceManager:
        """The one that the environment names, from which it is taken out: children must not speak for the server.

        Args:
            environment: variables.
            pid: process id of the server.
        """
        address = environment.pop("NOTIFY_SOCKET", "")
        watchdog_us = environment.pop("WATCHDOG_USEC", "")
        watched_pid = environment.pop("WATCHDOG_PID", "")
        watched = watchdog_us.isdecimal() and watched_pid in ("", str(pid))
        return cls(address, int(watchdog_us) / _US_PER_S if watched else 0.0)

    def tell_ready(self, status: str) -> None:
        """The start is over."""
        self._send("READY=1", f"STATUS={status}")

    def tell_status(self, status: str) -> None:
        """What is to be shown of the server, one line."""
        self._send(f"STATUS={status}")

    def tell_alive(self) -> None:
        """Begin the time anew after which the server would be ended."""
        if not self._unsent:
            self._send("WATCHDOG=1")

    def tell_stopping(self) -> None:
        """The end has begun."""
        self._send("STOPPING=1", "STATUS=stopping")

    def tell_again(self) -> None:
        """Tell what could not be told because it did not read."""
        while self._unsent and self._sent(self._unsent[0]):
            self._unsent.popleft()

    def close(self) -> None:
        """Tell nothing more."""
        self.tell_again()
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, *assignments: str) -> None:
        if self._socket is not None:
            self._unsent.append("\n".join(each.replace("\n", " ") for each in assignments).encode())
            self.tell_again()

    def _sent(self, datagram: bytes) -> bool:
        """Send without waiting; whether it need not be tried again."""
        try:
            if self._socket is not None:
                self._socket.send(datagram)
        except BlockingIOError:
            return False
        except OSError as error:
            log.debug("the service manager cannot be told: %s", error)
        return True


def _connected(address: str) -> socket.socket | None:
    """A socket to the service manager; None, and a line in the log, where there is none."""
    path = "\0" + address[1:] if address.startswith(_ABSTRACT) else address
    telling = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        telling.connect(path)
    except (OSError, ValueError) as error:
        telling.close()
        log.warning("NOTIFY_SOCKET: %s cannot be reached: %s", address, error)
        return None
    return telling


def environment_manager() -> ServiceManager:
    """The service manager of this process."""
    return ServiceManager.of_environment(os.environ, os.getpid())
