"""The last lines of the log of all processes, and the service ``/armbridge/last_log_lines`` that returns them."""

import logging
import threading
from collections import deque
from datetime import UTC, datetime
from typing import Any

from robot.logs import LineHandler, LogLine
from server.graph.permissions import CONFIGURING
from server.graph.topics import Graph

SERVICE = "/armbridge/last_log_lines"

# Some hours of a quiet server, some minutes of a busy one.
MAX_LINES = 1000

# All lines together, as tracebacks are long.
MAX_CHARACTERS = 500_000


class LogRing:
    """The last lines of this process's log and of its children's, from its construction to :meth:`close`."""

    def __init__(self) -> None:
        self._lines: deque[LogLine] = deque()
        self._characters = 0
        # Lines come from every thread that logs.
        self._lock = threading.Lock()
        self._handler = LineHandler("server", self.take)

    def close(self) -> None:
        self._handler.close()

    def take(self, line: LogLine) -> None:
        """Keep a line in the place of the oldest ones."""
        with self._lock:
            self._lines.append(line)
            self._characters += len(line.text)
            while len(self._lines) > MAX_LINES or self._characters > MAX_CHARACTERS:
                self._characters -= len(self._lines.popleft().text)

    def since(self, from_s: float) -> list[LogLine]:
        """Return the lines from a monotonic time on [s], in the order in which they came."""
        with self._lock:
            return [line for line in self._lines if line.monotonic_s >= from_s]

    def offer(self, graph: Graph) -> None:
        def serve(_request: dict[str, Any]) -> dict[str, Any]:
            return {"success": True, "message": "\n".join(map(shown, self.since(0.0)))}

        # Lines name addresses and files.
        graph.node("log").offer(SERVICE, "std_srvs/Trigger", serve, rule=CONFIGURING)


def shown(line: LogLine) -> str:
    """Return a line for people, its time in UTC."""
    time = datetime.fromtimestamp(line.at_s, UTC).isoformat(timespec="milliseconds")
    return f"{time} {logging.getLevelName(line.level):7} {line.process} {line.logger}: {line.text}"
