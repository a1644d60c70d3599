"""Servo bus: instructions out, replies in, and no wrong reading taken for a good one.

Packets are sent by ``scservo_sdk``; replies are received here, since the SDK takes stale bytes for replies.
The line is half-duplex and replies come in the order of the instructions, but nothing in a reply identifies the
instruction that it answers. So instructions are distinguished by the number of bytes that they ask for:

* A single read asks for 3 to 14 bytes, another number each time, and uses the first one or two.
* A sync read asks for at least 15, and after any disturbance for another number than before.

A late or repeated reply then has the wrong length for the present instruction and is skipped.

Reads and verified writes of one servo are also available as sequences (:func:`read`, :func:`read_block`,
:func:`write_verified`), which share the bus with the 100 Hz tick.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from itertools import cycle

from scservo_sdk import (
    BROADCAST_ID,
    INST_PING,
    INST_READ,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
    PacketHandler,
)

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.packets import (
    StatusFrame,
    instruction_packet,
    parse_status_frames,
    status_bytes,
    sync_write_parameters,
)
from robot.hardware.feetech.registers import LAYOUT, Register, decode, encode
from robot.hardware.half_duplex import MAX_BURST_BYTES, HalfDuplexBus
from robot.hardware.interface import Steps
from robot.hardware.port import BusPort, open_port

# Attempts before a servo counts as silent: single packets get lost while others draw current.
ATTEMPTS = 3

# Attempts of a sequence: five lost packets in a row mean that no servo is there.
STEP_ATTEMPTS = 5

# Lengths of single reads, all longer than any register and shorter than any sync read.
READ_LENGTHS = range(3, 15)

# Sync reads ask for this many bytes at least, and for up to SYNC_READ_PADDINGS - 1 steps more while the line
# is disturbed: a reply would have to come sixteen failed reads (over 70 ms) late to be taken for a new one.
SYNC_READ_MIN_LENGTH = 15
SYNC_READ_PADDINGS = 16

# The telemetry block has 15 bytes and the control block 16: even paddings keep their lengths apart, always.
SYNC_READ_PADDING_STEP = 2

# No reply is this late: a line undisturbed for so long is safe without padding.
CALM_S = 1.0

# Ids that a servo can have; 254 is the broadcast.
SERVO_IDS = range(254)

# Every servo replies to a broadcast ping after the time slots of those with lower ids. No document states the length of
# a slot; lerobot waits 3 ms for each of 252 ids.
PING_SLOT_S = 0.003

LITTLE_ENDIAN = 0


class Bus(HalfDuplexBus):
    """Bus of any number of servos on one port.

    Args:
        port: an open port, which the bus closes.
        clock: monotonic time of the port [s].

    Attributes:
        counters: events since the bus was opened.
    """

    def __init__(self, port: BusPort, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(port, PacketHandler(LITTLE_ENDIAN), clock)
        self._disturbed_s = self._last_byte_s
        self._read_lengths = cycle(READ_LENGTHS)
        self._padding = 0
        self._padding_is_safe = True

    @classmethod
    def open(cls, port: str, baudrate: int = 1_000_000) -> Bus:
        """Open the bus on a serial port; raises as :func:`robot.hardware.port.open_port`."""
        return cls(open_port(port, baudrate))

    def ping(self, servo_id: int, attempts: int = ATTEMPTS) -> int:
        """Ping a servo.

        Returns:
            Its model number, 777 for an STS3215.

        Raises:
            NoReply: it is missing, or badly connected.
            PortLost: the port is gone.
        """
        self._ask_one(servo_id, INST_PING, (), attempts)
        return self.read(servo_id, Register.MODEL_NUMBER, attempts)

    def broadcast_ping(self) -> dict[int, int]:
        """Ping all servos; takes 0.8 s.

        Two servos with the same id reply at once: their bytes count as ``discarded_bytes``.

        Returns:
            Error byte of each servo with a valid reply, by its id.

        Raises:
            PortLost: the port is gone.
        """
        self._await_quiet()
        self._send(instruction_packet(BROADCAST_ID, INST_PING))
        until_s = self._line_free_s + len(SERVO_IDS) * PING_SLOT_S + self._port.latency_s
        received = b""
        while (remaining_s := until_s - self._clock()) > 0.0 and len(received) < MAX_BURST_BYTES:
            received += self._port.receive(remaining_s)
        frames = parse_status_frames(received, SERVO_IDS, 0)
        self.counters.replies += len(frames)
        self.counters.discarded_bytes += len(received) - status_bytes(0, len(frames))
        self._note_disturbance()
        return {servo_id: frame.error for servo_id, frame in sorted(frames.items())}

    def read(self, servo_id: int, register: Register, attempts: int = ATTEMPTS) -> int:
        """Read one register.

        Args:
            servo_id: id of the servo.
            register: register to read.
            attempts: number of attempts; a silent servo costs up to 9 ms each time.

        Raises:
            NoReply: the servo gave no valid reply.
            PortLost: the port is gone.
        """
        for attempt in range(attempts):
            self._await_quiet()
            length = next(self._read_lengths)
            packet = instruction_packet(servo_id, INST_READ, (register, length))
            frame = self._exchange(packet, (servo_id,), length).get(servo_id)
            if frame is not None:
                return decode(register, frame.data[: LAYOUT[register].size])
            self._count_retry(attempt, attempts)
        raise NoReply(servo_id, attempts)

    def write(self, servo_id: int, register: Register, value: int, attempts: int = ATTEMPTS) -> None:
        """Write one register and wait for the acknowledgement.

        An acknowledgement has no content to check: values that matter for safety must be read back.

        Raises:
            NoReply: the servo did not acknowledge; it may have taken the value.
            PortLost: the port is gone.
            ValueError: the register cannot hold the value.
        """
        self._ask_one(servo_id, INST_WRITE, (register, *encode(register, value)), attempts)

    def sync_read(self, ids: Sequence[int], address: int, length: int) -> dict[int, StatusFrame]:
        """Read the same block of several servos in one transaction.

        Args:
            ids: in the order of the replies.
            address: first register of the block.
            length: bytes of the block.

        Returns:
            Valid replies that came in time, by id.

        Raises:
            PortLost: the port is gone.
        """
        self._await_quiet()
        asked_length = max(length, SYNC_READ_MIN_LENGTH) + self._choose_padding()
        packet = instruction_packet(BROADCAST_ID, INST_SYNC_READ, (address, asked_length, *ids))
        frames = self._exchange(packet, ids, asked_length)
        if asked_length == length:
            return frames
        return {servo_id: StatusFrame(servo_id, frame.error, frame.data[:length]) for servo_id, frame in frames.items()}

    def broadcast_torque_off(self) -> None:
        """Switch every servo's torque off at once, over replies in progress and without acknowledgement.

        Raises:
            PortLost: the port is gone.
        """
        self._send(instruction_packet(BROADCAST_ID, INST_WRITE, (Register.TORQUE_ENABLE, 0)))

    def _ask_one(self, servo_id: int, instruction: int, parameters: Sequence[int], attempts: int) -> None:
        """Send an instruction whose reply carries no data, until the servo replies."""
        packet = instruction_packet(servo_id, instruction, parameters)
        for attempt in range(attempts):
            self._await_quiet()
            if self._exchange(packet, (servo_id,), 0):
                return
            self._count_retry(attempt, attempts)
        raise NoReply(servo_id, attempts)

    def _count_retry(self, attempt: int, attempts: int) -> None:
        if attempt + 1 < attempts:
            self.counters.retries += 1

    def _parse_replies(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        return parse_status_frames(received, ids, data_length)

    def _reply_bytes(self, data_length: int, replies: int) -> int:
        return status_bytes(data_length, replies)

    def _sync_write_packet(self, address: int, data_by_id: dict[int, bytes]) -> list[int]:
        return instruction_packet(BROADCAST_ID, INST_SYNC_WRITE, sync_write_parameters(address, data_by_id))

    def _note_disturbance(self) -> None:
        super()._note_disturbance()
        self._disturbed_s = self._clock()
        self._padding_is_safe = False

    def _choose_padding(self) -> int:
        """Choose the padding that distinguishes a sync read from those whose replies may still come."""
        if self._clock() - self._disturbed_s > CALM_S:
            self._padding = 0
        elif not self._padding_is_safe:
            self._padding = (self._padding + 1) % SYNC_READ_PADDINGS
        self._padding_is_safe = True
        return self._padding * SYNC_READ_PADDING_STEP


def read(bus: Bus, servo_id: int, register: Register) -> Steps[int]:
    """Read one register, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(STEP_ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            return bus.read(servo_id, register, attempts=1)
    raise NoReply(servo_id, STEP_ATTEMPTS)


def read_block(bus: Bus, servo_id: int, address: int, length: int) -> Steps[StatusFrame]:
    """Read a block of registers of one servo, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(STEP_ATTEMPTS):
        yield 0.0
        frame = bus.sync_read((servo_id,), address, length).get(servo_id)
        if frame is not None:
            return frame
    raise NoReply(servo_id, STEP_ATTEMPTS)


def write_verified(bus: Bus, servo_id: int, register: Register, value: int) -> Steps[None]:
    """Write a register until it reads back, as a sequence: the reply to a write that worked may be lost.

    Raises:
        StartupError: the servo keeps another value.
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(STEP_ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            bus.write(servo_id, register, value, attempts=1)
        if (yield from read(bus, servo_id, register)) == value:
            return
    raise StartupError(f"servo {servo_id} does not take {value} in register {register.name}")
