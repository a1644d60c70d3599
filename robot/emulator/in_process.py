"""Port of an emulated bus inside the arm process, which answers within the call.

No reply can be late, since the servos' time is the caller's. The packets are the same, byte for byte, as those on a
pseudo terminal (:mod:`robot.emulator.process`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from robot.emulator.servo_bus import BAUDRATE, Reply, ServoBus
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S

# What a frozen adapter keeps, as a pseudo terminal does (N_TTY_BUF_SIZE in Linux).
MAX_WAITING_BYTES = 4096


class InProcessPort:
    """Port of an emulated bus, and its adapter.

    Implements :class:`robot.hardware.port.BusPort` for the host and :class:`robot.emulator.control.Adapter` for
    live commands.

    Args:
        bus: the servo bus.
        clock: time of bus and caller [s].
        wait: lets that time pass [s], for a bus with wire time; None for one without.

    Attributes:
        port: its name.
        frozen: True while it neither takes nor delivers bytes, which wait meanwhile.
        frame_s: interval at multiples of which replies are delivered [s], as USB does; 0 delivers them at once, and so
            does a bus without wire time, whose caller does not wait for a frame's end.
    """

    def __init__(
        self, bus: ServoBus[Any], clock: Callable[[], float], wait: Callable[[float], None] | None = None
    ) -> None:
        self.port = self.port_name = EmulatedConfig.port
        self.baudrate = BAUDRATE
        self.is_using = False
        # Without wire time only replies that a command delays are late, and those are not waited for.
        self.latency_s, self.quiet_s = (0.0, 0.0) if wait is None else (LOCAL_LATENCY_S, QUIET_S)
        self.discarded_bytes = 0
        self.frame_s = 0.0
        self._frozen = False
        self._waiting = b""
        self._bus = bus
        self._clock = clock
        self._wait = wait
        self._plugged = True
        self._outbox: deque[tuple[float, Reply]] = deque()

    @property
    def frozen(self) -> bool:
        """True while it neither takes nor delivers bytes."""
        return self._frozen

    @frozen.setter
    def frozen(self, on: bool) -> None:
        self._frozen = on
        if not on:
            waiting, self._waiting = self._waiting, b""
            self._pass_on(waiting)

    def plug_in(self, *, renamed: bool = False) -> None:  # noqa: ARG002 - only the name of a real port would change
        """Make the port usable again."""
        self._plugged = True

    def unplug(self) -> None:
        """Make the port unusable, and drop the bytes not delivered yet."""
        self._plugged = False
        self._outbox.clear()
        self._waiting = b""

    def check(self) -> None:
        """Raise PortError while the port is unplugged."""
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged by a command to the emulator")

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Discard the input that has arrived."""
        self.discarded_bytes += len(self._take())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Pass a packet to the servos; a frozen adapter keeps it until it goes on, if there is room.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        if not self._frozen:
            self._pass_on(bytes(packet))
        elif len(self._waiting) + len(packet) <= MAX_WAITING_BYTES:
            self._waiting += bytes(packet)
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        """Return the bytes that have arrived by now; with wire time, wait for the next ones.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        data = self._take()
        if data or self._wait is None or timeout_s <= 0.0:
            return data
        now_s = self._clock()
        due_s = self._outbox[0][0] if self._outbox and not self.frozen else now_s + timeout_s
        self._wait(min(timeout_s, max(due_s - now_s, 0.0)))
        return self._take()

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port; the servos keep running."""
        self._outbox.clear()

    def _pass_on(self, data: bytes) -> None:
        frame_s = 0.0 if self._wait is None else self.frame_s
        for reply in self._bus.receive(data, self._clock(), self.baudrate):
            due_s = math.ceil(reply.due_s / frame_s) * frame_s if frame_s else reply.due_s
            self._outbox.append((due_s, reply))

    def _take(self) -> bytes:
        if self.frozen:
            return b""
        now_s, data = self._clock(), b""
        while self._outbox and self._outbox[0][0] <= now_s:
            data += self._outbox.popleft()[1].data
        return data

    def _require_plugged(self) -> None:
        if not self._plugged:
            raise PortLost(self.port_name, "a command to the emulator unplugged it")
