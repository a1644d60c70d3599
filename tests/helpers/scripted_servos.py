"""Servos that follow a script, byte by byte: a second opinion on the bus, which shares no model with the emulator."""

from collections import deque
from collections.abc import Callable, Sequence

from scservo_sdk import BROADCAST_ID, INST_PING, INST_READ, INST_SYNC_READ, INST_SYNC_WRITE, INST_WRITE

from robot.calibration import Calibration
from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Instruction, InstructionParser
from robot.hardware.feetech.bus import Bus
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S
from tests.helpers.emulator import SteppedClock

# What a far end says to an instruction: bytes, and how long after the instruction they come [s]. Bytes leave in the
# order in which they were scripted, as they would pass one wire: a late one holds up those behind it.
Script = Callable[[Instruction], list[tuple[float, bytes]]]


class ScriptedPort:
    """A :class:`robot.hardware.port.BusPort`; who waits for its bytes moves the clock.

    Args:
        script: answers every instruction.
        clock: time of port and bus.

    Attributes:
        instructions: those that were sent.
    """

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


# Addresses and values of Feetech's memory table V3.6, as bytes: nothing here asks robot.hardware.feetech.registers.
MODEL, MIN_LIMIT, MAX_LIMIT, VOLTAGE_LIMITS, MAX_TORQUE = 3, 9, 11, 14, 16
TORQUE, GOAL, TORQUE_LIMIT, LOCK, PRESENT, VOLTAGE, TEMPERATURE = 40, 42, 48, 55, 56, 62, 63
MEMORY_BYTES = 128


class ScriptedServos:
    """A script for :class:`tests.helpers.terminal_servos.ScriptedPeer`: servos that are at their goal at once."""

    def __init__(self, calibration: Calibration) -> None:
        self.memory = {joint.servo_id: bytearray(MEMORY_BYTES) for joint in calibration.joints}
        for joint in calibration.joints:
            self._put(joint.servo_id, MODEL, 777)
            self._put(joint.servo_id, MIN_LIMIT, joint.range_min)
            self._put(joint.servo_id, MAX_LIMIT, joint.range_max)
            self._put(joint.servo_id, VOLTAGE_LIMITS, 80 | 40 << 8)
            self._put(joint.servo_id, MAX_TORQUE, 1000)
            self._put(joint.servo_id, TORQUE_LIMIT, 1000)
            self._put(joint.servo_id, LOCK, 1)
            self._put(joint.servo_id, PRESENT, joint.ticks_from_rad(0.1))
            self._put(joint.servo_id, VOLTAGE, 50)
            self._put(joint.servo_id, TEMPERATURE, 30)

    def __call__(self, instruction: Instruction) -> list[tuple[float, bytes]]:
        """Obey, and return the replies."""
        code, parameters, servo = instruction.code, bytes(instruction.parameters), instruction.servo_id
        if code == INST_SYNC_READ:
            address, length = parameters[:2]
            return [(0.0, self._reply(each, address, length)) for each in parameters[2:] if each in self.memory]
        if code == INST_SYNC_WRITE:
            address, length = parameters[:2]
            for at in range(2, len(parameters), length + 1):
                self._write(parameters[at], address, parameters[at + 1 : at + 1 + length])
            return []
        if code == INST_WRITE:
            for each in self.memory if servo == BROADCAST_ID else (servo,):
                self._write(each, parameters[0], parameters[1:])
        if servo not in self.memory or code not in (INST_PING, INST_READ, INST_WRITE):
            return []
        asked = parameters[:2] if code == INST_READ else b"\0\0"
        return [(0.0, self._reply(servo, asked[0], asked[1]))]

    def _reply(self, servo: int, address: int, length: int) -> bytes:
        return FEETECH.status_packet(servo, 0, bytes(self.memory[servo][address : address + length]))

    def _write(self, servo: int, address: int, data: bytes) -> None:
        memory = self.memory[servo]
        memory[address : address + len(data)] = data
        if memory[TORQUE] == 1:
            memory[PRESENT : PRESENT + 2] = memory[GOAL : GOAL + 2]

    def _put(self, servo: int, address: int, value: int) -> None:
        self.memory[servo][address : address + 2] = value.to_bytes(2, "little")
