"""The servos' side of the wire: instructions in, status packets out when the wire would have carried them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from scservo_sdk import BROADCAST_ID, INST_PING, INST_READ, INST_SYNC_READ, INST_SYNC_WRITE, INST_WRITE

from robot.emulator.servo import Servo
from robot.emulator.write_log import WriteLog
from robot.packets import HEADER, LENGTH_OVERHEAD, checksum, wire_time_s
from robot.registers import Register

BAUDRATE = 1_000_000

# From the end of what a servo waits for to the start of its reply.
TURNAROUND_S = 20e-6
RETURN_DELAY_UNIT_S = 2e-6

# A packet that stays unfinished this long was cut off, and does not swallow the next one.
PARTIAL_PACKET_S = 0.005

# Header, id, LEN and checksum.
_FRAME_BYTES = 5


@dataclass(frozen=True)
class Instruction:
    """A sound packet from the host."""

    servo_id: int
    code: int
    parameters: bytes

    @property
    def byte_count(self) -> int:
        """Bytes of the packet on the wire."""
        return len(self.parameters) + LENGTH_OVERHEAD + _FRAME_BYTES - 1


@dataclass(frozen=True)
class Reply:
    """Bytes for the host, and the time from which it may have them (monotonic [s])."""

    due_s: float
    data: bytes


@dataclass
class Faults:
    """What goes wrong on the bus.

    Attributes:
        drop: probability that a reply is lost.
        corrupt: probability that one byte of a reply is wrong.
        offline: ids of servos that neither hear nor speak.
        random: where chance comes from.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    offline: set[int] = field(default_factory=set)
    random: random.Random = field(default_factory=lambda: random.Random(0))  # noqa: S311 - repeatable faults, no secret

    def strike(self, packet: bytes) -> bytes:
        """Return what arrives of a reply."""
        if self.random.random() < self.drop:
            return b""
        if self.random.random() < self.corrupt:
            at = self.random.randrange(len(packet))
            wrong = packet[at] ^ self.random.randrange(1, 256)
            return packet[:at] + bytes([wrong]) + packet[at + 1 :]
        return packet


def status_packet(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Build a servo's reply."""
    body = bytes([servo_id, len(data) + LENGTH_OVERHEAD, error]) + data
    return HEADER + body + bytes([checksum(body)])


class InstructionParser:
    """Cuts the host's bytes into instructions; what is not sound is skipped."""

    def __init__(self) -> None:
        self._buffer = b""
        self._last_byte_s = 0.0

    def feed(self, data: bytes, now_s: float) -> list[Instruction]:
        """Return the instructions completed by ``data``."""
        if now_s - self._last_byte_s > PARTIAL_PACKET_S:
            self._buffer = b""
        self._last_byte_s = now_s
        self._buffer += data
        instructions = []
        at = self._buffer.find(HEADER)
        while 0 <= at <= len(self._buffer) - _FRAME_BYTES:
            end = at + self._buffer[at + 3] + _FRAME_BYTES - 1
            if end > len(self._buffer) and self._buffer[at + 2] <= BROADCAST_ID:
                break
            instruction = self._instruction(at, end)
            if instruction is not None:
                instructions.append(instruction)
            at = self._buffer.find(HEADER, at + 1 if instruction is None else end)
        self._buffer = self._buffer[at:] if at >= 0 else self._buffer[-1:]
        return instructions

    def _instruction(self, at: int, end: int) -> Instruction | None:
        body = self._buffer[at + 2 : end - 1]
        if len(body) <= LENGTH_OVERHEAD or end > len(self._buffer) or self._buffer[end - 1] != checksum(body):
            return None
        return Instruction(servo_id=body[0], code=body[2], parameters=body[3:])


class ServoBus:
    """All servos of the arm on one wire.

    Args:
        servos: in the order of their ids.
        faults: may be changed while the bus runs.
        now_s: monotonic time [s].
        log: where writes are recorded, if anywhere.
    """

    def __init__(self, servos: Sequence[Servo], faults: Faults, now_s: float, log: WriteLog | None = None) -> None:
        self.servos = tuple(servos)
        self.faults = faults
        self._log = log
        self._parser = InstructionParser()
        self._now_s = now_s
        self._wire_free_s = now_s

    def advance(self, now_s: float) -> None:
        """Let the servos move until ``now_s``."""
        for servo in self.servos:
            servo.step(now_s - self._now_s)
        self._now_s = now_s

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Take bytes from the host.

        Returns:
            The replies, each with the time at which its last byte has passed the wire.
        """
        self.advance(now_s)
        replies = []
        for instruction in self._parser.feed(data, now_s):
            self._wire_free_s = max(now_s, self._wire_free_s) + wire_time_s(instruction.byte_count, BAUDRATE)
            burst = b""
            for servo, packet in self._execute(instruction):
                delay_s = TURNAROUND_S + servo.value(Register.RETURN_DELAY) * RETURN_DELAY_UNIT_S
                self._wire_free_s += delay_s + wire_time_s(len(packet), BAUDRATE)
                burst += self.faults.strike(packet)
            if burst:
                replies.append(Reply(self._wire_free_s, burst))
        return replies

    def _execute(self, instruction: Instruction) -> list[tuple[Servo, bytes]]:
        """Do what the host says, and return who replies with what, in order."""
        parameters = instruction.parameters
        match instruction.code, len(parameters):
            case (code, 0) if code == INST_PING:
                return [(servo, status_packet(servo.servo_id, servo.error)) for servo in self._addressed(instruction)]
            case (code, 2) if code == INST_READ and instruction.servo_id != BROADCAST_ID:
                return [self._read(servo, parameters) for servo in self._addressed(instruction)]
            case (code, count) if code == INST_SYNC_READ and count > 2:
                present = {servo.servo_id: servo for servo in self._online()}
                return [self._read(present[i], parameters[:2]) for i in parameters[2:] if i in present]
            case (code, count) if code == INST_WRITE and count > 1:
                return self._write(instruction)
            case (code, count) if code == INST_SYNC_WRITE and count > 2:
                self._sync_write(parameters)
        return []

    def _online(self) -> list[Servo]:
        return [servo for servo in self.servos if servo.servo_id not in self.faults.offline]

    def _addressed(self, instruction: Instruction) -> list[Servo]:
        return [servo for servo in self._online() if instruction.servo_id in (servo.servo_id, BROADCAST_ID)]

    def _read(self, servo: Servo, address_and_length: bytes) -> tuple[Servo, bytes]:
        data = servo.read(*address_and_length)
        return servo, status_packet(servo.servo_id, servo.error, data)

    def _write(self, instruction: Instruction) -> list[tuple[Servo, bytes]]:
        address, data = instruction.parameters[0], instruction.parameters[1:]
        servos = self._addressed(instruction)
        written = {servo.servo_id: data for servo in servos}
        for servo in servos:
            servo.write(address, data)
        self._record("write", address, written)
        if instruction.servo_id == BROADCAST_ID:
            return []
        return [
            (servo, status_packet(servo.servo_id, servo.error))
            for servo in servos
            if servo.value(Register.RESPONSE_LEVEL) != 0
        ]

    def _sync_write(self, parameters: bytes) -> None:
        address, length, blocks = parameters[0], parameters[1], parameters[2:]
        present = {servo.servo_id: servo for servo in self._online()}
        written = {}
        for at in range(0, len(blocks) - length, length + 1):
            servo_id, data = blocks[at], blocks[at + 1 : at + 1 + length]
            if servo_id in present:
                present[servo_id].write(address, data)
                written[servo_id] = data
        self._record("sync_write", address, written)

    def _record(self, instruction: str, address: int, written: dict[int, bytes]) -> None:
        if self._log is not None and written:
            self._log.record(self._now_s, instruction, address, written, self.servos)
