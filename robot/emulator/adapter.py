"""USB adapter between the host and the emulated servos, as far as its two kinds are alike."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

from robot.emulator.servo_bus import Reply


class Adapter(ABC):
    """Adapter that can freeze, deliver in frames, and be unplugged."""

    def __init__(self, port: str) -> None:
        self.port = port  # its name, the last one while it is unplugged
        self.frozen = False  # True while it neither takes nor delivers bytes, which wait meanwhile
        self.frame_s = 0.0  # interval at multiples of which it delivers the servos' bytes [s]; 0 for at once
        self._outbox: deque[tuple[float, Reply]] = deque()

    @abstractmethod
    def plug_in(self, *, renamed: bool = False) -> None:
        """Create the port, under another name if ``renamed``, unless it is there."""

    @abstractmethod
    def unplug(self) -> None:
        """Remove the port, and drop the bytes not delivered yet."""

    def take(self, replies: Sequence[Reply]) -> None:
        """Queue replies of the servos, to be delivered to the host when they are due.

        Without frames a burst is delivered as a whole, which wakes the host once.
        """
        for reply in replies:
            due_s = math.ceil(reply.due_s / self.frame_s) * self.frame_s if self.frame_s else replies[-1].due_s
            self._outbox.append((due_s, reply))

    def wait_s(self, now_s: float, most_s: float) -> float:
        """Return the time until bytes are due for the host [s], ``most_s`` at most."""
        if not self._outbox or self.frozen:
            return most_s
        return max(0.0, min(most_s, self._outbox[0][0] - now_s))

    def due_bytes(self, now_s: float) -> bytes:
        """Take the bytes that are due for the host out of the queue."""
        due = b""
        while not self.frozen and self._outbox and self._outbox[0][0] <= now_s:
            due += self._outbox.popleft()[1].data
        return due
