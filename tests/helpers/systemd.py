"""Systemd's end of the notification socket."""

import socket
import threading
import time
from pathlib import Path

from harness.waiting import TIMEOUT_S


class Systemd:
    """A service notifier, which keeps all that it hears."""

    def __init__(self, path: Path) -> None:
        self.heard: list[str] = []
        self.address = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)
        self._reader = threading.Thread(target=self._listen)
        self._reader.start()

    def has_heard(self, words: str, times: int = 1) -> bool:
        until_s = time.monotonic() + TIMEOUT_S
        while self.heard.count(words) < times and time.monotonic() < until_s:
            time.sleep(0.02)
        return self.heard.count(words) >= times

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RD)
        self._reader.join(TIMEOUT_S)
        self._socket.close()

    def _listen(self) -> None:
        while datagram := self._socket.recv(4096):
            self.heard += datagram.decode().splitlines()
