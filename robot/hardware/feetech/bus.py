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
    COMM_SUCCESS,
    INST_PING,
    INST_READ,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
    PacketHandler,
)

from robot.errors import NoReply, PortLost, StartupError
from robot.hardware.feetech.packets import (
    StatusFrame,
    instruction_packet,
    parse_status_frames,
    status_bytes,
    sync_write_parameters,
    wire_time_s,
)
from robot.hardware.feetech.registers import LAYOUT, Register, decode, encode
from robot.hardware.interface import BusCounters, Steps
from robot.hardware.port import QUIET_S, BusPort, open_port

# Attempts before a servo counts as silent: single packets get lost while others draw current.
ATTEMPTS = 3

# Attempts of a sequence: five lost packets in a row mean that no servo is there.
STEP_ATTEMPTS = 5

# A line that does not fall quiet is used after this time; the parser rejects what does not fit.
QUIET_LIMIT_S = 0.03

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

# More than 20 ms of wire time: no servo sends that much in reply to one instruction.
MAX_BURST_BYTES = 2048

LITTLE_ENDIAN = 0


class Bus:
    """Bus of any number of servos on one port.

    Args:
        port: an open port, which the bus closes.
        clock: monotonic time of the port [s].

    Attributes:
        counters: events since the bus was opened.
    """

    def __init__(self, port: BusPort, clock: Callable[[], float] = time.monotonic) -> None:
        self.counters = BusCounters()
        self._port = port
        self._clock = clock
        self._sdk = PacketHandler(LITTLE_ENDIAN)
        self._disturbed = True  # an earlier process may have left replies on the line
        self._disturbed_s = self._last_byte_s = clock()
        self._line_free_s = self._last_byte_s
        self._read_lengths = cycle(READ_LENGTHS)
        self._padding = 0
        self._padding_is_safe = True
        # The latest replies and their frames: those of an arm at rest repeat.
        self._replied: tuple[bytes, tuple[int, ...], int] = (b"", (), 0)
        self._replied_frames: dict[int, StatusFrame] = {}
        self._written: dict[int, bytes] = {}
        self._written_address = 0
        self._written_packet: list[int] = []

    @classmethod
    def open(cls, port: str, baudrate: int = 1_000_000) -> Bus:
        """Open the bus on a serial port; raises as :func:`robot.hardware.port.open_port`."""
        return cls(open_port(port, baudrate))

    def close(self) -> None:
        """Close the port; the servos keep their goals."""
        self._port.closePort()

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

    def sync_write(self, address: int, data_by_id: dict[int, bytes]) -> None:
        """Write the same block of several servos in one packet, which none of them acknowledges.

        Args:
            address: first register of the block.
            data_by_id: bytes for each servo, all of one length; the dict must not be changed afterwards.

        Raises:
            PortLost: the port is gone.
            ValueError: the data differ in length or exceed a packet.
        """
        if data_by_id is not self._written or address != self._written_address:
            parameters = sync_write_parameters(address, data_by_id)
            self._written_packet = instruction_packet(BROADCAST_ID, INST_SYNC_WRITE, parameters)
            self._written, self._written_address = data_by_id, address
        self._await_quiet()
        self._send(self._written_packet)

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

    def _exchange(self, packet: list[int], ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Send an instruction and collect its replies."""
        self._send(packet)
        received, frames = self._collect(ids, data_length)
        replies = len(frames)
        missing, surplus = len(ids) - replies, len(received) - status_bytes(data_length, replies)
        self.counters.replies += replies
        self.counters.timeouts += missing
        self.counters.discarded_bytes += surplus
        if missing or surplus:
            self._note_disturbance()
        return frames

    def _collect(self, ids: Sequence[int], data_length: int) -> tuple[bytes, dict[int, StatusFrame]]:
        """Receive until every servo has replied, the replies have stopped, or their time is over."""
        whole_bytes = status_bytes(data_length, len(ids))
        deadline_s = self._line_free_s + wire_time_s(whole_bytes, self._port.baudrate) + self._port.latency_s
        received = b""
        frames: dict[int, StatusFrame] = {}
        while len(frames) < len(ids) and len(received) < MAX_BURST_BYTES:
            until_s = min(deadline_s, self._last_byte_s + self._port.quiet_s) if received else deadline_s
            chunk = self._port.receive(max(0.0, until_s - self._clock()))
            if not chunk:
                break
            self._last_byte_s = self._clock()
            received += chunk
            if len(received) >= whole_bytes:
                frames = self._parse(received, ids, data_length)
            if self._last_byte_s >= deadline_s:
                break
        return received, frames or self._parse(received, ids, data_length)

    def _parse(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Parse replies; the same bytes as before, in reply to the same instruction, give the same dict."""
        replied = received, tuple(ids), data_length
        if replied != self._replied:
            self._replied, self._replied_frames = replied, parse_status_frames(received, ids, data_length)
        return self._replied_frames

    def _send(self, packet: list[int]) -> None:
        discarded = self._port.discarded_bytes
        try:
            result = self._sdk.txPacket(self._port, packet)
        finally:
            self._port.is_using = False
        if result != COMM_SUCCESS:
            raise PortLost(self._port.port_name, self._sdk.getTxRxResult(result))
        self.counters.sent += 1
        self.counters.discarded_bytes += self._port.discarded_bytes - discarded
        start_s = max(self._clock(), self._line_free_s)
        self._line_free_s = start_s + wire_time_s(len(packet), self._port.baudrate)

    def _note_disturbance(self) -> None:
        self._disturbed = True
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

    def _await_quiet(self) -> None:
        """Discard unexpected bytes, and after a disturbance wait until no more come."""
        limit_s = self._clock() + QUIET_LIMIT_S
        while True:
            wait_s = max(0.0, self._last_byte_s + QUIET_S - self._clock()) if self._disturbed else 0.0
            chunk = self._port.receive(wait_s)
            if not chunk:
                break
            self.counters.discarded_bytes += len(chunk)
            self._last_byte_s = self._clock()
            self._note_disturbance()
            if self._last_byte_s > limit_s:
                break
        self._disturbed = False


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
