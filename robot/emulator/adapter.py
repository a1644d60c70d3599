"""USB adapter between the host and the emulated servos; inside the arm process it answers within the call."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from robot.emulator.servo_bus import BAUDRATE, Reply, ServoBus
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S

MAX_WAITING_BYTES = 4096  # what a frozen adapter keeps, as a pseudo terminal does (N_TTY_BUF_SIZE in Linux)


class Adapter(ABC):
    """Adapter that can freeze, deliver in frames, and be unplugged."""

    def __init__(self, port: str) -> None:
        self.port = port  # its name, the last one while it is unplugged
        self.frozen = False  # True while it neither takes nor delivers bytes, which wait meanwhile
        self.frame_s = 0.0  # it delivers the servos' bytes at multiples of this interval [s]; 0 for immediately
        self._outbox: deque[tuple[float, Reply]] = deque()

    @abstractmethod
    def plug_in(self, *, renamed: bool = False) -> None:
        """Create the port, under another name if ``renamed``, unless it is there."""

    @abstractmethod
    def unplug(self) -> None:
        """Remove the port, and drop the bytes not delivered yet."""

    def take(self, replies: Sequence[Reply]) -> None:
        """Queue replies until they are due for the host; without frames a burst wakes it once, as a whole."""
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


class InProcessPort(Adapter):
    """Port of an emulated bus for the host; with wire time, ``wait`` lets the time of bus and caller pass [s]."""

    def __init__(
        self, bus: ServoBus[Any], clock: Callable[[], float], wait: Callable[[float], None] | None = None
    ) -> None:
        super().__init__(EmulatedConfig.port)
        self.port_name = self.port
        self.baudrate = BAUDRATE
        self.is_using = False
        self.latency_s, self.quiet_s = (0.0, 0.0) if wait is None else (LOCAL_LATENCY_S, QUIET_S)
        self.discarded_bytes = 0
        self._waiting = b""
        self._bus = bus
        self._clock = clock
        self._wait = wait
        self._plugged = True

    def plug_in(self, *, renamed: bool = False) -> None:  # noqa: ARG002 - only the name of a real port would change
        """Make the port usable again."""
        self._plugged = True

    def unplug(self) -> None:
        """Make the port unusable, and drop the bytes not delivered yet."""
        self._plugged = False
        self._waiting = b""
        self._outbox.clear()

    def check(self) -> None:
        """Raise PortError while the port is unplugged."""
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged by a command to the emulator")

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Discard the input that has arrived."""
        self.discarded_bytes += len(self._arrived())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Pass a packet to the servos; a frozen adapter keeps it until it goes on, if there is room."""
        self._require_plugged()
        if len(self._waiting) + len(packet) <= MAX_WAITING_BYTES:
            self._waiting += bytes(packet)
        self._pass_on()
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        """Return the bytes that have arrived by now; with wire time, wait for the next ones."""
        self._require_plugged()
        data = self._arrived()
        if data or self._wait is None or timeout_s <= 0.0:
            return data
        self._wait(self.wait_s(self._clock(), timeout_s))
        return self._arrived()

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port; the servos keep running."""
        self._outbox.clear()

    def _pass_on(self) -> None:
        if not self.frozen and self._waiting:
            data, self._waiting = self._waiting, b""
            replies = self._bus.receive(data, self._clock(), self.baudrate)
            if self._wait is None:
                self._outbox.extend((reply.due_s, reply) for reply in replies)
            else:
                self.take(replies)

    def _arrived(self) -> bytes:
        self._pass_on()
        return self.due_bytes(self._clock())

    def _require_plugged(self) -> None:
        if not self._plugged:
            raise PortLost(self.port_name, "a command to the emulator unplugged it")
