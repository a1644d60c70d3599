"""The test's end of the socket that takes live commands to the servos inside an arm process."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path

# The arm process listens as soon as it knows its arm, and takes commands at every tick.
CONNECT_TIMEOUT_S = 30.0
ANSWER_TIMEOUT_S = 30.0


class EmulatorControl:
    """A controller of the emulated servos whose control socket is at a path; connects anew for each command.

    Args:
        path: as the settings name it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def command(self, **command: object) -> dict[str, object]:
        """Send one live command and return the answer."""
        with self._connected() as controller, controller.makefile("rb") as lines:
            controller.sendall(json.dumps(command).encode() + b"\n")
            answer: dict[str, object] = json.loads(lines.readline())
        return answer

    def _connected(self) -> socket.socket:
        until_s = time.monotonic() + CONNECT_TIMEOUT_S
        while True:
            controller = socket.socket(socket.AF_UNIX)
            controller.settimeout(ANSWER_TIMEOUT_S)
            try:
                controller.connect(str(self.path))
            except OSError:
                # An arm process that was killed is being replaced.
                controller.close()
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.01)
            else:
                return controller
