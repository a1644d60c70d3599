"""Emulated servo bus: timing and losses on the half-duplex wire, instruction packets parsed, status packets built.

:class:`ServoBus` takes the host's bytes and returns the replies; :func:`execute` carries out one instruction on the
servos that receive it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from types import MappingProxyType

from scservo_sdk import (
    BROADCAST_ID,
    INST_ACTION,
    INST_PING,
    INST_READ,
    INST_REG_WRITE,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
)

from robot.emulator.faults import Faults
from robot.emulator.servo import Servo
from robot.emulator.write_log import WriteLog
from robot.hardware.feetech.packets import HEADER, LENGTH_OVERHEAD, checksum
from robot.hardware.feetech.registers import Register
from robot.hardware.port import wire_time_s

BAUDRATE = 1_000_000

# Register BAUD_RATE (Feetech's memory table V3.6).
BAUDRATES: Mapping[int, int] = MappingProxyType(
    dict(enumerate((1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)))
)

# Instructions of Feetech's protocol manual without a name in its SDK.
INST_RESTORE = 0x06
INST_REBOOT = 0x08
INST_BACKUP = 0x09
INST_RESET = 0x0A
INST_CALIBRATE = 0x0B

# Instructions that change nothing.
READING = (INST_PING, INST_READ, INST_SYNC_READ)

# A packet that is incomplete for so long was cut off, and is dropped so that it does not swallow the next one.
PARTIAL_PACKET_S = 0.005

# Header, id, LEN and checksum.
_FRAME_BYTES = 5

# A byte on the wire: a start bit, which is low, eight bits and a stop bit; all but the last one inverted.
_BITS_PER_BYTE = 10
_INVERTED = 0x1FF

# Time from the end of the packet before to the start of a reply.
TURNAROUND_S = 20e-6
RETURN_DELAY_UNIT_S = 2e-6

# A survey sends some dozens of different requests.
MAX_ANSWERED = 64

# Interval of updating the weight, which changes slowly with the pose.
WEIGHING_S = 0.01


class ServoBus:
    """Servos of an arm on one wire.

    Args:
        servos: in the order of their ids.
        faults: faults of the bus, which may be changed while it runs.
        now_s: monotonic time [s].
        log: record of the writes; None for no record.
        weigh: loads the servos with the links' weight at the present pose; None for an arm without weight.
        wire_time: True to emulate the time of bytes on the wire; otherwise replies are complete at once, and cannot
            collide with what the host sends.

    Attributes:
        servos: as given.
        faults: as given.
    """

    def __init__(
        self,
        servos: Sequence[Servo],
        faults: Faults,
        now_s: float,
        log: WriteLog | None = None,
        weigh: Callable[[], None] | None = None,
        *,
        wire_time: bool = True,
    ) -> None:
        self.servos = tuple(servos)
        self.faults = faults
        self._log = log
        self._weigh = weigh or (lambda: None)
        self._weigh()
        self._weighed_s = now_s
        self._wire_time = wire_time
        self._parser = InstructionParser()
        self._now_s = now_s
        self._wire_free_s = self._given_s = now_s
        self._on_wire: list[Reply] = []
        # Every tick of an arm at rest repeats a request: requests since the last change, and their replies.
        self._answered: dict[tuple[bytes, int], bytes] = {}
        self._visible: list[tuple[object, ...]] = []

    def advance(self, now_s: float) -> None:
        """Advance the servos to the monotonic time ``now_s`` [s]."""
        if now_s <= self._now_s:
            return
        for servo in self.servos:
            servo.step(now_s - self._now_s)
        self._now_s = now_s
        if now_s - self._weighed_s >= WEIGHING_S and not all(servo.plant.at_rest for servo in self.servos):
            self._weighed_s = now_s
            self._weigh()
        visible = [servo.visible for servo in self.servos]
        if visible != self._visible:
            self._visible = visible
            self._answered.clear()

    def receive(self, data: bytes, now_s: float, baudrate: int = BAUDRATE) -> list[Reply]:
        """Receive bytes from the host.

        Bytes that collide with replies still on the wire are lost, and so is the rest of those replies. Instructions
        that arrive together wait for the replies to the one before: the gaps between them are not known here.

        Args:
            data: bytes from the host.
            now_s: monotonic time [s].
            baudrate: baud rate of the host; 0 for one that no servo has.

        Returns:
            Replies; they may be cut by a collision until they have passed the wire.
        """
        self.advance(now_s)
        if self._on_wire and now_s < self._on_wire[-1].end_s:
            for reply in self._on_wire:
                reply.collide(now_s)
            return []
        self._on_wire = []
        if baudrate == 0:
            return []
        request = data, baudrate
        if not self._parser.begun and (again := self._answered.get(request)) is not None:
            due_s = max(now_s, self._given_s)
            return [Reply(now_s, wire_time_s(1, baudrate), now_s, due_s, again)] if again else []
        changes = sum(servo.changes for servo in self.servos)
        instructions = self._parser.feed(data, now_s)
        for instruction in instructions:
            self._wire_free_s = max(now_s, self._wire_free_s) + self._takes_s(instruction.byte_count, baudrate)
            if not self.faults.loses_instruction():
                self._execute(instruction, baudrate)
        # A request that changed a register may have another reply the next time, or none after a change of the id.
        unchanged = changes == sum(servo.changes for servo in self.servos)
        whole = [instruction.byte_count for instruction in instructions] == [len(data)]
        if whole and unchanged and not (self._wire_time or self._log is not None or self.faults.by_chance):
            if len(self._answered) >= MAX_ANSWERED:
                self._answered.clear()
            self._answered[request] = b"".join(reply.data for reply in self._on_wire)
        return self._on_wire

    def record_command(self, command: Mapping[str, object]) -> None:
        """Record a live command among the writes, and bring everything up to date that it may have changed."""
        self._answered.clear()
        for servo in self.servos:
            servo.update_protection()
        if self._log is not None:
            self._log.record_command(self._now_s, command, self.servos)

    def _execute(self, instruction: Instruction, baudrate: int) -> None:
        """Carry out an instruction on the servos that receive it, and put their replies on the wire."""
        hearers = [servo for servo in self.servos if self._hears(servo, baudrate)]
        effects = execute(instruction, hearers, stall_behind_missing=self.faults.stall_behind_missing)
        if instruction.code not in READING:
            self._answered.clear()
        for effect in effects:
            for _, together in groupby(effect.answers, key=lambda answer: answer.servo.servo_id):
                self._reply(list(together), baudrate)
            if self._log is not None and effect.written:
                self._log.record_write(self._now_s, instruction.code, effect.address, effect.written, self.servos)

    def _hears(self, servo: Servo, baudrate: int) -> bool:
        speaks = servo.connected and servo.servo_id not in self.faults.offline
        return speaks and BAUDRATES.get(servo.baudrate_code) == baudrate

    def _reply(self, answers: Sequence[Answer], baudrate: int) -> None:
        """Put the reply of a servo on the wire, or those of several with the same id, which collide."""
        servo = answers[0].servo
        delay_s = TURNAROUND_S + servo.value(Register.RETURN_DELAY) * RETURN_DELAY_UNIT_S if self._wire_time else 0.0
        start_s = self._wire_free_s + delay_s
        packets = [status_packet(answer.servo.servo_id, answer.servo.error, answer.data) for answer in answers]
        packet = packets[0] if len(packets) == 1 else superimposed(packets)
        arriving = self.faults.apply(packet)
        self._wire_free_s = start_s + self._takes_s(max(len(packet), len(arriving)), baudrate)
        self._given_s = max(self._given_s, self._wire_free_s + self.faults.hold_up_s())
        self._on_wire.append(Reply(start_s, wire_time_s(1, baudrate), self._wire_free_s, self._given_s, arriving))

    def _takes_s(self, byte_count: int, baudrate: int) -> float:
        return wire_time_s(byte_count, baudrate) if self._wire_time else 0.0


@dataclass
class Reply:
    """Reply on its way to the host; times are monotonic [s].

    Attributes:
        start_s: time of its first bit on the wire.
        byte_s: wire time of each byte.
        end_s: time of its last bit.
        due_s: time from which the host may have it; later than ``end_s`` if it is delayed.
        data: bytes of the packet.
    """

    start_s: float
    byte_s: float
    end_s: float
    due_s: float
    data: bytes

    def collide(self, now_s: float) -> None:
        """Drop the bytes that have not passed the wire: the host sends as well, so that their frames are broken."""
        passed = int((now_s - self.start_s) / self.byte_s)
        self.data = self.data[: max(0, passed)]


@dataclass(frozen=True)
class Instruction:
    """Valid instruction packet."""

    servo_id: int
    code: int
    parameters: bytes

    @property
    def byte_count(self) -> int:
        """Number of bytes of the packet on the wire."""
        return len(self.parameters) + LENGTH_OVERHEAD + _FRAME_BYTES - 1


class InstructionParser:
    """Parser of the host's bytes; invalid packets are skipped."""

    def __init__(self) -> None:
        self._buffer = b""
        self._last_byte_s = 0.0

    @property
    def begun(self) -> bool:
        """True while the remaining bytes may be the beginning of an instruction."""
        return self._buffer.startswith(HEADER[:1])

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


def superimposed(packets: Sequence[bytes]) -> bytes:
    """Return the bytes that a host receives of packets sent at once.

    No two servos begin at the same instant: each one is a bit behind the one before. The line is low while any of them
    pulls it down, and the host takes eight bits behind each start bit.

    Args:
        packets: packet of each servo.
    """
    # 1 for each bit time in which the line is low, the first in the lowest bit.
    low = 0
    for delay, packet in enumerate(packets):
        for at, byte in enumerate(packet):
            low |= (byte << 1 ^ _INVERTED) << (delay + at * _BITS_PER_BYTE)
    received = bytearray()
    while low:
        low >>= (low & -low).bit_length()
        received.append(low & 0xFF ^ 0xFF)
        low >>= _BITS_PER_BYTE - 1
    return bytes(received)


def status_packet(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Build a servo's reply."""
    body = bytes([servo_id, len(data) + LENGTH_OVERHEAD, error]) + data
    return HEADER + body + bytes([checksum(body)])


@dataclass(frozen=True)
class Answer:
    """Data of a servo's status packet."""

    servo: Servo
    data: bytes = b""


@dataclass
class Effect:
    """Effect of an instruction.

    Attributes:
        answers: status packets, in the order of sending.
        address: first register written.
        written: servo id to the bytes written there; several addresses need several effects.
    """

    answers: list[Answer] = field(default_factory=list)
    address: int = 0
    written: dict[int, bytes] = field(default_factory=dict)


def execute(instruction: Instruction, servos: Sequence[Servo], *, stall_behind_missing: bool = False) -> list[Effect]:
    """Carry out an instruction.

    Args:
        instruction: anything; what makes no sense does nothing.
        servos: those that hear it.
        stall_behind_missing: True if a sync read ends at the first servo that does not reply.
    """
    parameters = instruction.parameters
    hearers = [servo for servo in servos if instruction.servo_id in (servo.servo_id, BROADCAST_ID)]
    broadcast = instruction.servo_id == BROADCAST_ID
    match instruction.code, len(parameters):
        case (code, 0) if code == INST_PING:
            return [Effect([Answer(servo) for servo in sorted(hearers, key=lambda servo: servo.servo_id)])]
        case (code, 2) if code == INST_READ and not broadcast:
            return [Effect([Answer(servo, servo.read(*parameters)) for servo in hearers])]
        case (code, count) if code == INST_SYNC_READ and count > 2:
            return [Effect(_sync_read(servos, parameters, stall_behind_missing=stall_behind_missing))]
        case (code, count) if code == INST_SYNC_WRITE and count > 2:
            return [_sync_write(servos, parameters)]
        case (code, count) if code in (INST_WRITE, INST_REG_WRITE) and count > 1:
            return [_write(hearers, parameters, broadcast=broadcast, kept=code == INST_REG_WRITE)]
        case (code, 0) if code == INST_ACTION:
            return _action(hearers, broadcast=broadcast)
        case (code, _) if code in _MAINTENANCE:
            for servo in hearers:
                _MAINTENANCE[code](servo)
            return [Effect(_acknowledgements(hearers, broadcast=broadcast))]
    return []


# The arm's joints turn less than once: there is no count of turns for INST_RESET to clear.
_MAINTENANCE: Mapping[int, Callable[[Servo], None]] = MappingProxyType(
    {
        INST_RESTORE: Servo.restore,
        INST_REBOOT: Servo.power_up,
        INST_BACKUP: Servo.back_up,
        INST_RESET: lambda _servo: None,
        INST_CALIBRATE: Servo.make_middle,
    }
)


def _acknowledgements(hearers: Sequence[Servo], *, broadcast: bool) -> list[Answer]:
    if broadcast:
        return []
    return [Answer(servo) for servo in hearers if servo.value(Register.RESPONSE_LEVEL) != 0]


def _sync_read(servos: Sequence[Servo], parameters: bytes, *, stall_behind_missing: bool) -> list[Answer]:
    answers = []
    for servo_id in parameters[2:]:
        asked = [servo for servo in servos if servo.servo_id == servo_id]
        answers += [Answer(servo, servo.read(parameters[0], parameters[1])) for servo in asked]
        if not asked and stall_behind_missing:
            break
    return answers


def _write(hearers: Sequence[Servo], parameters: bytes, *, broadcast: bool, kept: bool) -> Effect:
    address, data = parameters[0], parameters[1:]
    for servo in hearers:
        if kept:
            servo.keep_write(address, data)
        else:
            servo.write(address, data)
    written = {} if kept else {servo.servo_id: data for servo in hearers}
    return Effect(_acknowledgements(hearers, broadcast=broadcast), address, written)


def _action(hearers: Sequence[Servo], *, broadcast: bool) -> list[Effect]:
    effects = [Effect(_acknowledgements(hearers, broadcast=broadcast))]
    for servo in hearers:
        taken = servo.take_kept_write()
        if taken is not None:
            effects.append(Effect([], taken[0], {servo.servo_id: taken[1]}))
    return effects


def _sync_write(servos: Sequence[Servo], parameters: bytes) -> Effect:
    address, length, blocks = parameters[0], parameters[1], parameters[2:]
    effect = Effect([], address)
    for at in range(0, len(blocks) - length, length + 1):
        servo_id, data = blocks[at], blocks[at + 1 : at + 1 + length]
        for servo in servos:
            if servo.servo_id == servo_id:
                servo.write(address, data)
                effect.written[servo_id] = data
    return effect
