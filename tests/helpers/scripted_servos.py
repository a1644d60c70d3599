"""A port whose far end answers by a script, byte by byte."""

from collections import deque
from collections.abc import Callable, Sequence

from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Instruction, InstructionParser
from robot.hardware.feetech.bus import Bus
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S
from tests.helpers.emulator import SteppedClock

# What a far end says to an instruction: bytes, and how long after the instruction they come [s]. Bytes leave in the
# order in which they were scripted, as they would pass one wire: a late one holds up those behind it.
Script = Callable[[Instruction], list[tuple[float, bytes]]]


class ScriptedPort:
    """A :class:`robot.hardware.port.BusPort` with a script; who waits for its bytes moves the clock."""

    def __init__(self, script: Script, clock: SteppedClock | None = None) -> None:
        self.script = script
        self.clock = clock or SteppedClock()
        self.instructions: list[Instruction] = []
        self.port_name = "scripted"
        self.baudrate = 1_000_000
        self.is_using = False
        self.latency_s, self.quiet_s = LOCAL_LATENCY_S, QUIET_S
        self.discarded_bytes = 0
        self._parser = InstructionParser(FEETECH)
        self._outbox: deque[tuple[float, bytes]] = deque()

    def open_bus(self) -> Bus:
        return Bus(self, self.clock)

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        self.discarded_bytes += len(self._arrived())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        for instruction in self._parser.feed(bytes(packet), self.clock()):
            self.instructions.append(instruction)
            for delay_s, data in self.script(instruction):
                last_due_s = self._outbox[-1][0] if self._outbox else 0.0
                self._outbox.append((max(last_due_s, self.clock() + delay_s), data))
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        data = self._arrived()
        if not data and timeout_s > 0.0:
            due_s = self._outbox[0][0] if self._outbox else float("inf")
            self.clock.advance(min(timeout_s, due_s - self.clock()))
            data = self._arrived()
        return data

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        self._outbox.clear()

    def _arrived(self) -> bytes:
        data = b""
        while self._outbox and self._outbox[0][0] <= self.clock():
            data += self._outbox.popleft()[1]
        return data
