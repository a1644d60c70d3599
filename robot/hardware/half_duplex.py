"""Half-duplex line of a servo bus: an instruction out, its replies in, and quiet before the next one.

Packets are sent by a servo maker's SDK; replies are received here, in bounded time. After a missing or surplus byte the
line is disturbed: it is used again once it has fallen quiet, so that no late reply is taken for the next one. What
packets look like is told by the subclasses, one for each kind of servo.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from robot.errors import PortLost
from robot.hardware.interface import BusCounters
from robot.hardware.port import QUIET_S, BusPort

# Result of both SDKs' txPacket for a packet that was sent.
COMM_SUCCESS = 0

# Start bit, eight data bits and stop bit.
BITS_PER_BYTE = 10

# A line that does not fall quiet is used after this time; the parser rejects what does not fit.
QUIET_LIMIT_S = 0.03

# More than 20 ms of wire time: no servo sends that much in reply to one instruction.
MAX_BURST_BYTES = 2048


class StatusFrame(NamedTuple):
    """Valid reply of a servo.

    Attributes:
        servo_id: id of the servo.
        error: ERR byte; Feetech's bits are :class:`robot.hardware.interface.StatusFlag`, and set ones do not make the
            data wrong; Dynamixel's bit 7 is a hardware error, the rest the number of an error of the instruction.
        data: bytes of the registers.
    """

    servo_id: int
    error: int
    data: bytes


class Sdk(Protocol):
    """Packet handler of a servo maker's SDK."""

    def txPacket(self, port: BusPort, txpacket: list[int]) -> int:  # noqa: N802 - the SDK's name
        """Complete a packet and send it; return a communication result."""

    def getTxRxResult(self, result: int) -> str:  # noqa: N802 - the SDK's name
        """Return a communication result as text."""


def wire_time_s(byte_count: int, baudrate: int) -> float:
    """Compute the time of bytes on the wire [s]."""
    return byte_count * BITS_PER_BYTE / baudrate


class HalfDuplexBus(ABC):
    """Bus of any number of servos on one port.

    Args:
        port: an open port, which the bus closes.
        sdk: sends packets.
        clock: monotonic time of the port [s].

    Attributes:
        counters: events since the bus was opened.
    """

    def __init__(self, port: BusPort, sdk: Sdk, clock: Callable[[], float]) -> None:
        self.counters = BusCounters()
        self._port = port
        self._clock = clock
        self._sdk = sdk
        self._disturbed = True  # an earlier process may have left replies on the line
        self._line_free_s = self._last_byte_s = clock()
        # The latest replies and their frames: those of an arm at rest repeat.
        self._replied: tuple[bytes, tuple[int, ...], int] = (b"", (), 0)
        self._replied_frames: dict[int, StatusFrame] = {}
        self._written: dict[int, bytes] = {}
        self._written_address = 0
        self._written_packet: list[int] = []

    @abstractmethod
    def _parse_replies(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Find the replies of the expected servos in the bytes received since the instruction."""

    @abstractmethod
    def _reply_bytes(self, data_length: int, replies: int) -> int:
        """Return the bytes of some replies with so much data each, as long as nothing has to be added to them."""

    def _added_bytes(self, received: bytes) -> int:  # noqa: ARG002 - for subclasses
        """Return the bytes that replies have beyond :meth:`_reply_bytes`."""
        return 0

    def _answer_delay_s(self, replies: int) -> float:  # noqa: ARG002 - for subclasses
        """Return the time that servos may take before they reply [s]."""
        return 0.0

    @abstractmethod
    def _sync_write_packet(self, address: int, data_by_id: dict[int, bytes]) -> list[int]:
        """Build a packet that writes the same block of several servos."""

    @property
    def latency_s(self) -> float:
        """Time that a reply may take beyond its wire time [s]."""
        return self._port.latency_s

    def close(self) -> None:
        """Close the port; the servos keep their goals."""
        self._port.closePort()

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
            self._written_packet = self._sync_write_packet(address, data_by_id)
            self._written, self._written_address = data_by_id, address
        self._await_quiet()
        self._send(self._written_packet)

    def _exchange(self, packet: list[int], ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Send an instruction and collect its replies."""
        self._send(packet)
        received, frames = self._collect(ids, data_length)
        missing = len(ids) - len(frames)
        surplus = len(received) - self._reply_bytes(data_length, len(frames)) - self._added_bytes(received)
        self.counters.replies += len(frames)
        self.counters.timeouts += missing
        self.counters.discarded_bytes += max(surplus, 0)
        if missing or surplus:
            self._note_disturbance()
        return frames

    def _collect(self, ids: Sequence[int], data_length: int) -> tuple[bytes, dict[int, StatusFrame]]:
        """Receive until every servo has replied, the replies have stopped, or their time is over."""
        whole_bytes = self._reply_bytes(data_length, len(ids))
        replies_s = wire_time_s(whole_bytes, self._port.baudrate) + self._answer_delay_s(len(ids))
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
            self._replied, self._replied_frames = replied, self._parse_replies(received, ids, data_length)
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
        """Note that bytes are missing, or were not expected."""
        self._disturbed = True

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
