"""Dynamixel bus: instructions out, replies in.

Packets are sent by ``dynamixel_sdk``; replies are received here, since the SDK polls for up to 34 ms for each, more
than three ticks. The line is half-duplex: after a missing or surplus byte the bus waits until the line has fallen
quiet before it sends again, so that no late reply is taken for the next one.

Pings, reads and verified writes of one servo are also available as sequences (:func:`ping`, :func:`read`,
:func:`write_verified`), which share the bus with the 100 Hz tick.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from dynamixel_sdk import (
    BROADCAST_ID,
    COMM_SUCCESS,
    INST_PING,
    INST_READ,
    INST_REBOOT,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
    PacketHandler,
)

from robot.errors import NoReply, PortLost, StartupError
from robot.hardware.dynamixel.packets import (
    ALERT,
    StatusFrame,
    block_parameters,
    instruction_packet,
    parse_status_frames,
    status_bytes,
    stuffed_bytes,
    sync_write_parameters,
    wire_time_s,
)
from robot.hardware.dynamixel.registers import LAYOUT, Register, decode, encode
from robot.hardware.interface import BusCounters, Steps
from robot.hardware.port import QUIET_S, BusPort, open_port

PROTOCOL = 2.0

# Attempts of a sequence: five lost packets in a row mean that no servo is there.
STEP_ATTEMPTS = 5

# A line that does not fall quiet is used after this time; the parser rejects what does not fit.
QUIET_LIMIT_S = 0.03

# Longest delay of a reply, register RETURN_DELAY_TIME of 254; the factory's 250 is hardly less.
LONGEST_RETURN_DELAY_S = 254 * 2e-6

# More than 20 ms of wire time: no servo sends that much in reply to one instruction.
MAX_BURST_BYTES = 2048

# Data of the reply to a ping: model number and firmware version.
PING_BYTES = 3


class Identity(NamedTuple):
    """Reply to a ping.

    Attributes:
        model_number: register MODEL_NUMBER.
        firmware: register FIRMWARE_VERSION.
    """

    model_number: int
    firmware: int


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
        self._sdk = PacketHandler(PROTOCOL)
        self._disturbed = True  # an earlier process may have left replies on the line
        self._line_free_s = self._last_byte_s = clock()
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

    def ping(self, servo_id: int) -> Identity:
        """Ping a servo.

        Raises:
            NoReply: it is missing, or badly connected.
            PortLost: the port is gone.
        """
        data = self._ask(servo_id, INST_PING, (), PING_BYTES).data
        return Identity(int.from_bytes(data[:2], "little"), data[2])

    def read(self, servo_id: int, register: Register) -> int:
        """Read one register.

        Raises:
            NoReply: the servo gave no valid reply.
            PortLost: the port is gone.
        """
        size = LAYOUT[register].size
        return decode(register, self._ask(servo_id, INST_READ, block_parameters(register, size), size).data)

    def write(self, servo_id: int, register: Register, value: int) -> int:
        """Write one register and wait for the acknowledgement.

        An acknowledgement does not repeat the value: those that matter for safety must be read back.

        Returns:
            Number of the error that the servo reports, 0 for none: 4 and 6 for a value out of its range, 7 for a
            register that cannot be written now (e-manual, Status Packet, Error).

        Raises:
            NoReply: the servo did not acknowledge; it may have taken the value.
            PortLost: the port is gone.
            ValueError: the register cannot hold the value.
        """
        parameters = (register & 0xFF, register >> 8, *encode(register, value))
        return self._ask(servo_id, INST_WRITE, parameters, 0).error & ~ALERT

    def reboot(self, servo_id: int) -> None:
        """Reboot a servo: torque off, RAM as after power-up, latched errors cleared; it answers again a while later.

        Raises:
            NoReply: the servo did not acknowledge; it may reboot nevertheless.
            PortLost: the port is gone.
        """
        self._ask(servo_id, INST_REBOOT, (), 0)

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
        packet = instruction_packet(BROADCAST_ID, INST_SYNC_READ, (*block_parameters(address, length), *ids))
        return self._exchange(packet, ids, length)

    def sync_write(self, address: int, data_by_id: dict[int, bytes]) -> None:
        """Write the same block of several servos in one packet, which none of them acknowledges.

        Args:
            address: first register of the block.
            data_by_id: bytes for each servo, all of one length; the dict must not be changed afterwards.

        Raises:
            PortLost: the port is gone.
            ValueError: the data differ in length, or cannot be sent.
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
        self._send(instruction_packet(BROADCAST_ID, INST_WRITE, (Register.TORQUE_ENABLE, 0, 0)))

    def count_retry(self) -> None:
        """Count an instruction that is repeated because the servo gave no valid reply."""
        self.counters.retries += 1

    def _ask(self, servo_id: int, instruction: int, parameters: Sequence[int], data_length: int) -> StatusFrame:
        """Send an instruction to one servo and return its reply."""
        packet = instruction_packet(servo_id, instruction, parameters)
        self._await_quiet()
        frame = self._exchange(packet, (servo_id,), data_length).get(servo_id)
        if frame is None:
            raise NoReply(servo_id, 1)
        return frame

    def _exchange(self, packet: list[int], ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Send an instruction and collect its replies."""
        self._send(packet)
        received, frames = self._collect(ids, data_length)
        missing = len(ids) - len(frames)
        surplus = len(received) - status_bytes(data_length, len(frames)) - stuffed_bytes(received)
        self.counters.replies += len(frames)
        self.counters.timeouts += missing
        self.counters.discarded_bytes += max(surplus, 0)
        if missing or surplus:
            self._disturbed = True
            # A reply that has not come yet may still come.
            self._last_byte_s = self._clock()
        return frames

    def _collect(self, ids: Sequence[int], data_length: int) -> tuple[bytes, dict[int, StatusFrame]]:
        """Receive until every servo has replied, the replies have stopped, or their time is over."""
        whole_bytes = status_bytes(data_length, len(ids))
        replies_s = wire_time_s(whole_bytes, self._port.baudrate) + len(ids) * LONGEST_RETURN_DELAY_S
        deadline_s = self._line_free_s + replies_s + self._port.latency_s
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
            self._disturbed = True
            if self._last_byte_s > limit_s:
                break
        self._disturbed = False


def ping(bus: Bus, servo_id: int) -> Steps[Identity]:
    """Ping a servo, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for attempt in range(STEP_ATTEMPTS):
        yield from _before(bus, attempt)
        with contextlib.suppress(NoReply):
            return bus.ping(servo_id)
    raise NoReply(servo_id, STEP_ATTEMPTS)


def read(bus: Bus, servo_id: int, register: Register) -> Steps[int]:
    """Read one register, as a sequence.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for attempt in range(STEP_ATTEMPTS):
        yield from _before(bus, attempt)
        with contextlib.suppress(NoReply):
            return bus.read(servo_id, register)
    raise NoReply(servo_id, STEP_ATTEMPTS)


def write_verified(bus: Bus, servo_id: int, register: Register, value: int) -> Steps[None]:
    """Write a register until it reads back, as a sequence: the reply to a write that worked may be lost.

    Raises:
        StartupError: the servo keeps another value.
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    error = 0
    for attempt in range(STEP_ATTEMPTS):
        yield from _before(bus, attempt)
        with contextlib.suppress(NoReply):
            error = bus.write(servo_id, register, value)
        if (yield from read(bus, servo_id, register)) == value:
            return
    reported = f", and reports error {error} of protocol 2.0" if error else ""
    raise StartupError(f"servo {servo_id} does not take {value} in register {register.name} ({register}){reported}")


def _before(bus: Bus, attempt: int) -> Steps[None]:
    """Yield before a transaction; count it when it is repeated."""
    yield 0.0
    if attempt:
        bus.count_retry()
