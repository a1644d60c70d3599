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
    INST_PING,
    INST_READ,
    INST_REBOOT,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
    PacketHandler,
)

from robot.errors import NoReply, StartupError
from robot.hardware.dynamixel.packets import (
    ALERT,
    StatusFrame,
    block_parameters,
    instruction_packet,
    parse_status_frames,
    status_bytes,
    stuffed_bytes,
    sync_write_parameters,
)
from robot.hardware.dynamixel.registers import LAYOUT, Register, decode, encode
from robot.hardware.half_duplex import HalfDuplexBus
from robot.hardware.interface import Steps
from robot.hardware.port import BusPort, open_port

PROTOCOL = 2.0

# Attempts of a sequence: five lost packets in a row mean that no servo is there.
STEP_ATTEMPTS = 5

# Longest delay of a reply, register RETURN_DELAY_TIME of 254; the factory's 250 is hardly less.
LONGEST_RETURN_DELAY_S = 254 * 2e-6

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


class Bus(HalfDuplexBus):
    """Bus of any number of servos on one port.

    Args:
        port: an open port, which the bus closes.
        clock: monotonic time of the port [s].

    Attributes:
        counters: events since the bus was opened.
    """

    def __init__(self, port: BusPort, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(port, PacketHandler(PROTOCOL), clock)

    @classmethod
    def open(cls, port: str, baudrate: int = 1_000_000) -> Bus:
        """Open the bus on a serial port; raises as :func:`robot.hardware.port.open_port`."""
        return cls(open_port(port, baudrate))

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

    def _parse_replies(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        return parse_status_frames(received, ids, data_length)

    def _reply_bytes(self, data_length: int, replies: int) -> int:
        return status_bytes(data_length, replies)

    def _added_bytes(self, received: bytes) -> int:
        return stuffed_bytes(received)

    def _answer_delay_s(self, replies: int) -> float:
        return replies * LONGEST_RETURN_DELAY_S

    def _sync_write_packet(self, address: int, data_by_id: dict[int, bytes]) -> list[int]:
        return instruction_packet(BROADCAST_ID, INST_SYNC_WRITE, sync_write_parameters(address, data_by_id))

    def _note_disturbance(self) -> None:
        super()._note_disturbance()
        # A reply that has not come yet may still come.
        self._last_byte_s = self._clock()


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
