"""Port of an emulated bus inside the arm process, which answers within the call.

No reply can be late, since the servos' time is the caller's. The packets are the same, byte for byte, as those on a
pseudo terminal (:mod:`robot.emulator.process`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robot.emulator.adapter import Adapter
from robot.emulator.servo_bus import BAUDRATE, ServoBus
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S

# What a frozen adapter keeps, as a pseudo terminal does (N_TTY_BUF_SIZE in Linux).
MAX_WAITING_BYTES = 4096


class InProcessPort(Adapter):
    """Port of an emulated bus; implements :class:`robot.hardware.port.BusPort` for the host.

    Without wire time a reply is there at once, or, if a command delays it, not waited for; frames delay nothing. With
    wire time, ``wait`` lets the time of bus and caller pass [s].
    """

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
