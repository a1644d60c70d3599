"""Emulated servo bus, alike in every family: instructions, replies, losses on the wire, and the log of every write.

An :class:`EmulatedBus` takes the host's bytes and returns replies; a family's :class:`Codec` parses and builds packets.
Both families use the same codes of instructions (SDKs ``scservo_sdk`` and ``dynamixel_sdk``).
"""

from __future__ import annotations

import json
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

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

from robot.emulator.servo import EmulatedServo
from robot.hardware.port import wire_time_s

_NAMES: Mapping[int, str] = {INST_WRITE: "write", INST_SYNC_WRITE: "sync_write", INST_ACTION: "action"}


class WriteLog:
    """Log file with one JSON line for each write instruction or live command, flushed at once.

    A line has the times of the bus and of the machine's monotonic clock [s]; the instruction with the first address and
    the bytes by servo id, and the registers wholly written, or the live command; and of every servo, after the write,
    positions [ticks], torque limits [0.1 %] and error bits (register STATUS). Raises OSError for a file that cannot be
    written.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self._file = path.open("a" if append else "w", buffering=1)

    def record_write(
        self, now_s: float, code: int, address: int, data: Mapping[int, bytes], servos: Sequence[EmulatedServo[Any]]
    ) -> None:
        memory = servos[0].memory
        write = {
            "instruction": _NAMES[code],
            "address": address,
            "data": {servo_id: list(values) for servo_id, values in data.items()},
            "registers": {
                servo_id: {register.name: value for register, value in memory.decode_block(address, values).items()}
                for servo_id, values in data.items()
            },
        }
        self._append(now_s, write, servos)

    def record_command(self, now_s: float, command: Mapping[str, object], servos: Sequence[EmulatedServo[Any]]) -> None:
        self._append(now_s, {"instruction": "command", "address": None, "data": {}, "command": command}, servos)

    def close(self) -> None:
        self._file.close()

    def _append(self, now_s: float, event: Mapping[str, object], servos: Sequence[EmulatedServo[Any]]) -> None:
        line = {
            "t": now_s,
            "machine_t": time.monotonic(),
            **event,
            "present": {servo.servo_id: servo.present_ticks for servo in servos},
            "torque": {servo.servo_id: servo.named("TORQUE_ENABLE") for servo in servos},
            "goal": {servo.servo_id: servo.named("GOAL_POSITION") for servo in servos},
            "limit": {servo.servo_id: servo.torque_limit_permille for servo in servos},
            "status": {servo.servo_id: servo.error for servo in servos},
        }
        self._file.write(json.dumps(line) + "\n")


DELAY_S = 0.02  # longer than the host waits for a reply: a delayed one arrives after the next instruction

MAX_NOISE_BYTES = 8

SERVO_IDS = range(0xFD)  # ids that a servo can have


@dataclass
class Faults:
    """Probabilities of faults, and servos off the bus; may be changed while the bus runs."""

    drop: float = 0.0  # probability that a reply is lost
    corrupt: float = 0.0  # probability that one byte of a reply is wrong
    wrong_id: float = 0.0  # probability that a reply bears another id
    truncate: float = 0.0  # probability that a reply is cut short
    duplicate: float = 0.0  # probability that a reply comes twice
    noise: float = 0.0  # probability that noise comes before a reply
    delay: float = 0.0  # probability that a reply, and those behind it, are held up
    lose_instruction: float = 0.0  # probability that no servo hears an instruction
    delay_s: float = DELAY_S  # delay of a delayed reply [s]
    offline: set[int] = field(default_factory=set)  # ids of servos that neither receive nor reply
    # True if a sync read ends at the first servo that does not reply, as some firmware reportedly does; otherwise
    # those behind it reply in its slot.
    stall_behind_missing: bool = False
    random: random.Random = field(default_factory=lambda: random.Random(0))  # noqa: S311 - repeatable faults, no secret

    def happens(self, probability: float) -> bool:
        return probability > 0.0 and self.random.random() < probability

    def id_of_reply(self, servo_id: int) -> int:
        if not self.happens(self.wrong_id):
            return servo_id
        return self.random.choice([other for other in SERVO_IDS if other != servo_id])

    def apply(self, packet: bytes) -> bytes:
        """Apply the other faults of replies to one; return the bytes that arrive."""
        if self.happens(self.drop):
            return b""
        if self.happens(self.corrupt):
            at = self.random.randrange(len(packet))
            packet = packet[:at] + bytes([packet[at] ^ self.random.randrange(1, 256)]) + packet[at + 1 :]
        if self.happens(self.truncate):
            packet = packet[: self.random.randrange(1, len(packet))]
        if self.happens(self.duplicate):
            packet += packet
        if self.happens(self.noise):
            packet = self.random.randbytes(self.random.randint(1, MAX_NOISE_BYTES)) + packet
        return packet


S = TypeVar("S", bound=EmulatedServo[Any])

BAUDRATE = 1_000_000

# Time after which an incomplete packet counts as cut off; it is dropped so that it does not swallow the next one.
PARTIAL_PACKET_S = 0.005

TURNAROUND_S = 20e-6  # time from the end of the packet before to the start of a reply


@dataclass(frozen=True)
class Instruction:
    """Instruction packet."""

    servo_id: int  # id of its receiver, or the broadcast
    code: int  # number of the instruction
    parameters: bytes  # bytes behind it
    byte_count: int = field(default=0, compare=False)  # bytes of the packet on the wire
    error: int = 0  # number of the error that its receiver finds in it; 0 for none


class Codec(ABC):
    """Packets of a family of servos."""

    header: bytes  # first bytes of every packet
    word_bytes: int  # bytes of an address or length among the parameters, little endian
    # Number of the error with which a servo answers an instruction that makes no sense; None for silence.
    rejection: int | None

    @abstractmethod
    def end_of_instruction(self, received: bytes, at: int) -> int | None:
        """Return the end of the packet that begins at ``at``; None while it is incomplete."""

    @abstractmethod
    def instruction(self, packet: bytes) -> Instruction | None:
        """Parse a packet; None if it is invalid."""

    @abstractmethod
    def status_packet(self, servo_id: int, error: int, data: bytes = b"") -> bytes:
        """Build a servo's reply."""


class InstructionParser:
    """Parser of the host's bytes; invalid packets are skipped."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._buffer = b""
        self._last_byte_s = 0.0

    def feed(self, data: bytes, now_s: float) -> list[Instruction]:
        if now_s - self._last_byte_s > PARTIAL_PACKET_S:
            self._buffer = b""
        self._last_byte_s = now_s
        self._buffer += data
        header = self._codec.header
        instructions = []
        at = self._buffer.find(header)
        while at >= 0 and (end := self._codec.end_of_instruction(self._buffer, at)) is not None:
            instruction = self._codec.instruction(self._buffer[at:end])
            if instruction is not None:
                instructions.append(instruction)
            at = self._buffer.find(header, at + 1 if instruction is None else end)
        self._buffer = self._buffer[at:] if at >= 0 else self._buffer[1 - len(header) :]
        return instructions


@dataclass(slots=True)
class Reply:
    """Reply on its way to the host; times are monotonic [s]."""

    start_s: float  # time of its first bit on the wire
    byte_s: float  # wire time of each byte
    end_s: float  # time of its last bit
    due_s: float  # time from which the host may have it; later than ``end_s`` if it is delayed
    data: bytes  # bytes of the packet

    def collide(self, now_s: float) -> None:
        """Drop the bytes that have not passed the wire: the host sends as well, so that their frames are broken."""
        passed = int((now_s - self.start_s) / self.byte_s)
        self.data = self.data[: max(0, passed)]


class ServoReply(NamedTuple):
    """Servo that replies, the number of the error that it reports, 0 for none, and the data of its reply."""

    servo: EmulatedServo[Any]
    error: int = 0
    data: bytes = b""
    servo_id: int | None = None  # id in the reply; None for the servo's own


# First register -> servo id -> bytes written there.
Written: TypeAlias = dict[int, dict[int, bytes]]


class EmulatedBus(Generic[S]):
    """Servos of an arm on one wire."""

    def __init__(
        self,
        servos: Sequence[S],
        codec: Codec,
        faults: Faults,  # may be changed while the bus runs
        now_s: float,  # monotonic time [s]
        log: WriteLog | None = None,
        # Loads the servos with the links' weight at their pose, or moves their joints, after a time that passed [s].
        move: Callable[[float], None] = lambda _duration_s: None,
        *,
        wire_time: bool = True,  # without it replies are complete at once, and cannot collide with the host's bytes
    ) -> None:
        self.servos = tuple(servos)
        self.faults = faults
        self.log = log
        self._codec = codec
        self._move = move
        self._move(0.0)
        self._wire_time = wire_time
        self._parser = InstructionParser(codec)
        self._now_s = now_s
        self._wire_free_s = self._given_s = now_s
        self._on_wire: list[Reply] = []

    def advance(self, now_s: float) -> None:
        if now_s <= self._now_s:
            return
        duration_s, self._now_s = now_s - self._now_s, now_s
        for servo in self.servos:
            servo.step(duration_s)
        if not all(servo.plant.at_rest for servo in self.servos):
            self._move(duration_s)

    def receive(self, data: bytes, now_s: float, baudrate: int = BAUDRATE) -> list[Reply]:
        """Receive bytes from the host at a monotonic time [s]; return the replies, which a collision may cut.

        Bytes that collide with replies still on the wire are lost, and so is the rest of those replies. Instructions
        that arrive together wait for the replies to the one before: the gaps between them are not known here. No servo
        has a baud rate of 0.
        """
        self.advance(now_s)
        if self._on_wire and now_s < self._on_wire[-1].end_s:
            for reply in self._on_wire:
                reply.collide(now_s)
            return []
        self._on_wire = []
        if baudrate == 0:
            return []
        for instruction in self._parser.feed(data, now_s):
            wire_s = instruction.byte_count * self._byte_s(baudrate)
            self._wire_free_s = max(now_s, self._wire_free_s) + wire_s
            if not self.faults.happens(self.faults.lose_instruction):
                self._execute(instruction, baudrate)
        return self._on_wire

    def record_command(self, command: Mapping[str, object]) -> None:
        """Record a live command among the writes, and bring everything up to date that it may have changed."""
        for servo in self.servos:
            servo.update_protection()
        if self.log is not None:
            self.log.record_command(self._now_s, command, self.servos)

    def _execute(self, instruction: Instruction, baudrate: int) -> None:
        hearers = [
            servo
            for servo in self.servos
            if servo.listens and servo.baudrate == baudrate and servo.servo_id not in self.faults.offline
        ]
        written: Written = {}
        answers = list(self._answers(instruction, hearers, written))
        for _, together in groupby(answers, key=lambda answer: answer.servo.servo_id):
            self._reply(tuple(together), baudrate)
        if self.log is not None:
            for address, data in written.items():
                self.log.record_write(self._now_s, instruction.code, address, data, self.servos)

    def _answers(self, instruction: Instruction, hearers: Sequence[S], written: Written) -> Iterator[ServoReply]:
        """Carry out an instruction; yield the replies in the order of sending, and note the writes."""
        code, block_bytes = instruction.code, 2 * self._codec.word_bytes
        broadcast = instruction.servo_id == BROADCAST_ID
        if not instruction.error:
            for servo in hearers:
                servo.hear()
        if code in (INST_SYNC_READ, INST_SYNC_WRITE) and not instruction.error:
            if len(instruction.parameters) > block_bytes:
                address, length = self._words(instruction.parameters[:block_bytes])
                rest = instruction.parameters[block_bytes:]
                if code == INST_SYNC_READ:
                    yield from self._sync_read(hearers, address, length, rest)
                    return
                for at in range(0, len(rest) - length, length + 1):
                    for servo in hearers:
                        if servo.servo_id == rest[at]:
                            _write(servo, address, rest[at + 1 : at + 1 + length], written)
            return
        for servo in sorted(hearers, key=lambda servo: servo.servo_id):
            if broadcast or instruction.servo_id == servo.servo_id:
                # A broadcast is answered by nobody, except a ping. A reboot resets what a servo acknowledges.
                replies = servo.acknowledges(code) and (not broadcast or code == INST_PING)
                servo_id = servo.servo_id
                answer = self._execute_on(servo, instruction, written)
                if answer is not None and replies:
                    # The write of a new id is acknowledged with the old one: lerobot's setup_motors waits for that.
                    yield answer._replace(servo_id=servo_id)

    def _execute_on(self, servo: S, instruction: Instruction, written: Written) -> ServoReply | None:
        parameters, word_bytes = instruction.parameters, self._codec.word_bytes
        if instruction.error:
            return ServoReply(servo, instruction.error)
        match instruction.code, len(parameters):
            case (code, 0) if code == INST_PING:
                return ServoReply(servo, data=servo.ping())
            case (code, count) if code == INST_READ and count == 2 * word_bytes:
                return ServoReply(servo, data=servo.read(*self._words(parameters)))
            case (code, count) if code in (INST_WRITE, INST_REG_WRITE) and count > word_bytes:
                (address,), data = self._words(parameters[:word_bytes]), parameters[word_bytes:]
                if code == INST_REG_WRITE:
                    servo.kept_write = (address, data)
                    return ServoReply(servo)
                return ServoReply(servo, _write(servo, address, data, written))
            case (code, 0) if code == INST_ACTION:
                kept, servo.kept_write = servo.kept_write, None
                return ServoReply(servo, _write(servo, *kept, written) if kept else 0)
            case (code, _) if servo.maintain(code):
                return ServoReply(servo)
        return None if self._codec.rejection is None else ServoReply(servo, self._codec.rejection)

    def _sync_read(self, hearers: Sequence[S], address: int, length: int, ids: bytes) -> Iterator[ServoReply]:
        for servo_id in ids:
            asked = [servo for servo in hearers if servo.servo_id == servo_id]
            yield from (ServoReply(servo, data=servo.read(address, length)) for servo in asked)
            if not asked and self.faults.stall_behind_missing:
                break

    def _words(self, parameters: bytes) -> list[int]:
        size = self._codec.word_bytes
        return [int.from_bytes(parameters[at : at + size], "little") for at in range(0, len(parameters), size)]

    def _reply(self, answers: Sequence[ServoReply], baudrate: int) -> None:
        """Put the reply of a servo on the wire; replies of several servos with the same id collide."""
        servo, byte_s = answers[0].servo, self._byte_s(baudrate)
        start_s = self._wire_free_s + (TURNAROUND_S + servo.return_delay_s if self._wire_time else 0.0)
        sent_id = answers[0].servo_id
        servo_id = self.faults.id_of_reply(servo.servo_id if sent_id is None else sent_id)
        packet = _status_packet(self._codec, servo_id, servo.error | answers[0].error, answers[0].data)
        if len(answers) > 1:
            packet = self.faults.random.randbytes(len(packet))
        arriving = self.faults.apply(packet)
        self._wire_free_s = start_s + max(len(packet), len(arriving)) * byte_s
        held_up_s = self.faults.delay_s if self.faults.happens(self.faults.delay) else 0.0
        self._given_s = max(self._given_s, self._wire_free_s + held_up_s)
        self._on_wire.append(Reply(start_s, wire_time_s(1, baudrate), self._wire_free_s, self._given_s, arriving))

    def _byte_s(self, baudrate: int) -> float:
        return wire_time_s(1, baudrate) if self._wire_time else 0.0


@lru_cache(maxsize=64)
def _status_packet(codec: Codec, servo_id: int, error: int, data: bytes) -> bytes:
    """Return a packet; an arm at rest sends the same ones in each cycle, which takes 8 % of the emulated arm's time."""
    return codec.status_packet(servo_id, error, data)


def _write(servo: EmulatedServo[Any], address: int, data: bytes, written: Written) -> int:
    error = servo.write(address, data)
    if not error:
        written.setdefault(address, {})[servo.servo_id] = data
    return error
