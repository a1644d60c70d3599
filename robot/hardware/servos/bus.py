"""Half-duplex bus of servos: an instruction out, its replies in, and quiet before the next one.

After a missing or surplus byte the line is disturbed: it is used again once it has fallen quiet, so that no late reply
is taken for the next one. A family's subclass is the codec of its packets. Reads and verified writes of one servo are
also sequences, which share the bus with the 100 Hz tick.
"""

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, Self

from scservo_sdk import INST_READ, INST_SYNC_READ, INST_SYNC_WRITE, INST_WRITE

from robot.errors import NoReply, PortLost, StartupError
from robot.hardware.interface import Steps
from robot.hardware.port import QUIET_S, BusPort, open_port, wire_time_s
from robot.hardware.servos.registers import Block, RegisterEnum, RegisterTable
from robot.messages import BusCounters

ATTEMPTS = 3  # attempts before a servo counts as silent: single packets get lost while others draw current
STEP_ATTEMPTS = 5  # attempts of a sequence: five lost packets in a row mean that no servo is there
BROADCAST_ID = 254  # id that every servo takes for its own, in both makers' protocols
COMM_SUCCESS = 0  # result of both SDKs' txPacket for a packet that was sent
QUIET_LIMIT_S = 0.03  # a line that does not fall quiet is used after this time; the parser rejects what does not fit
MAX_BURST_BYTES = 2048  # more than 20 ms of wire time: no servo sends that much in reply to one instruction


class StatusFrame(NamedTuple):
    """Valid reply of a servo."""

    servo_id: int  # id of the servo
    # ERR byte; Feetech's bits are :class:`robot.hardware.interface.StatusFlag`, and set ones do not make the data
    # wrong; Dynamixel's bit 7 is a hardware error, the rest the number of an error of the instruction.
    error: int
    data: bytes  # bytes of the registers


class Sdk(Protocol):
    """Packet handler of a servo maker's SDK."""

    def txPacket(self, port: BusPort, txpacket: list[int]) -> int:  # noqa: N802 - the SDK's name
        """Complete a packet and send it; return a communication result."""

    def getTxRxResult(self, result: int) -> str:  # noqa: N802 - the SDK's name
        """Return a communication result as text."""


class ServoBus(ABC):
    """Bus of servos on an open port, which it closes; its methods raise PortLost, and NoReply without a valid reply."""

    registers: ClassVar[RegisterTable[Any]]
    word_bytes: ClassVar[int] = 1  # bytes of an address or length among the parameters, little endian
    reply_delay_s: ClassVar[float] = 0.0  # longest time that a servo takes before it replies [s]
    # Bits of the ERR byte with the number of an error of the instruction; 0 for a family that reports none.
    instruction_error_bits: ClassVar[int] = 0

    def __init__(self, port: BusPort, clock: Callable[[], float] = time.monotonic) -> None:
        self.counters = BusCounters()
        self._port = port
        self._clock = clock
        self._sdk = self._make_sdk()
        self._disturbed = True  # an earlier process may have left replies on the line
        self._line_free_s = self._last_byte_s = clock()
        # The latest replies and their frames: the replies of an arm at rest repeat.
        self._replied: tuple[bytes, tuple[int, ...], int] = (b"", (), 0)
        self._replied_frames: dict[int, StatusFrame] = {}
        self._written: dict[int, bytes] = {}
        self._written_address = 0
        self._written_packet: list[int] = []

    @classmethod
    def open(cls, port: str, baudrate: int = 1_000_000) -> Self:
        """Open the bus on a serial port; raises as :func:`robot.hardware.port.open_port`."""
        return cls(open_port(port, baudrate))

    # Codec of a family's packets.

    @abstractmethod
    def _make_sdk(self) -> Sdk:
        """Make the handler that completes and sends packets."""

    @abstractmethod
    def _packet(self, servo_id: int, instruction: int, parameters: Sequence[int]) -> list[int]:
        """Build an instruction for the SDK, which completes it; raise ValueError where it cannot send it."""

    @abstractmethod
    def _parse_replies(self, received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        """Find the replies of the expected servos in the bytes received since the instruction."""

    @abstractmethod
    def _reply_bytes(self, data_length: int, replies: int) -> int:
        """Count the bytes of a number of replies with data of this length, without :meth:`_added_bytes`."""

    def _added_bytes(self, received: bytes) -> int:
        """Count the bytes that replies have beyond :meth:`_reply_bytes`."""
        return 0

    def _read_length(self, size: int) -> int:
        """Return the number of bytes to ask for in order to read a register of a size."""
        return size

    @property
    def latency_s(self) -> float:
        """Time that a reply may take beyond its wire time [s]."""
        return self._port.latency_s

    def close(self) -> None:
        """Close the port; the servos keep their goals."""
        self._port.closePort()

    def ping(self, servo_id: int, attempts: int = ATTEMPTS) -> int:
        """Return a servo's model number; raises NoReply for a servo that is missing or badly connected."""
        return self.read(servo_id, self.registers.model_number, attempts)

    def read(self, servo_id: int, register: RegisterEnum, attempts: int = ATTEMPTS) -> int:
        """Read one register; a silent servo costs up to 9 ms an attempt."""
        size = register.size
        for attempt in range(attempts):
            self.counters.retries += attempt > 0
            self._await_quiet()
            length = self._read_length(size)
            packet = self._packet(servo_id, INST_READ, self._words(register, length))
            frame = self._exchange(packet, (servo_id,), length).get(servo_id)
            if frame is not None:
                return register.decode(frame.data[:size])
        raise NoReply(servo_id, attempts)

    def write(self, servo_id: int, register: RegisterEnum, value: int) -> int:
        """Write one register and return the number of the error that the servo reports, 0 for none.

        An acknowledgement does not repeat the value: values that matter for safety must be read back. Without one the
        servo may have taken the value. Raises ValueError for a value that the register cannot hold.
        """
        return self.ask(servo_id, self._write_packet(servo_id, register, value)).error & self.instruction_error_bits

    def sync_read(self, ids: Sequence[int], address: int, length: int) -> dict[int, StatusFrame]:
        """Read the same block of several servos in one transaction; return the valid replies in time, by id."""
        self._await_quiet()
        return self._exchange(self._sync_read_packet(ids, address, length), ids, length)

    def _write_packet(self, servo_id: int, register: RegisterEnum, value: int) -> list[int]:
        data = register.encode(value)
        return self._packet(servo_id, INST_WRITE, [*self._words(register), *data])

    def _sync_read_packet(self, ids: Sequence[int], address: int, length: int) -> list[int]:
        return self._packet(BROADCAST_ID, INST_SYNC_READ, [*self._words(address, length), *ids])

    def broadcast_torque_off(self) -> None:
        """Switch every servo's torque off at once, over replies in progress and without acknowledgement."""
        self._send(self._write_packet(BROADCAST_ID, self.registers.torque_enable, 0))

    def sync_write(self, address: int, data_by_id: dict[int, bytes]) -> None:
        """Write a block of several servos, unacknowledged; the dict's bytes have one length and never change."""
        if data_by_id is not self._written or address != self._written_address:
            lengths = set(map(len, data_by_id.values()))
            if len(lengths) != 1:
                raise ValueError(f"a sync write needs data of one length for all servos, not {sorted(lengths)} bytes")
            parameters = self._words(address, lengths.pop())
            for servo_id, data in data_by_id.items():
                parameters += [servo_id, *data]
            self._written_packet = self._packet(BROADCAST_ID, INST_SYNC_WRITE, parameters)
            self._written, self._written_address = data_by_id, address
        self._await_quiet()
        self._send(self._written_packet)

    def _words(self, *numbers: int) -> list[int]:
        return [number >> 8 * place & 0xFF for number in numbers for place in range(self.word_bytes)]

    def ask(self, servo_id: int, packet: list[int]) -> StatusFrame:
        """Send an instruction whose reply carries no data; raises NoReply."""
        self._await_quiet()
        frame = self._exchange(packet, (servo_id,), 0).get(servo_id)
        if frame is None:
            raise NoReply(servo_id, 1)
        return frame

    def _exchange(self, packet: list[int], ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
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
        replies_s = wire_time_s(whole_bytes, self._port.baudrate) + len(ids) * self.reply_delay_s
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


def read(bus: ServoBus, servo_id: int, register: RegisterEnum) -> Steps[int]:
    """Read one register, as a sequence; raises NoReply."""
    for attempt in range(STEP_ATTEMPTS):
        yield 0.0
        bus.counters.retries += attempt > 0
        with contextlib.suppress(NoReply):
            return bus.read(servo_id, register, attempts=1)
    raise NoReply(servo_id, STEP_ATTEMPTS)


def read_registers(bus: ServoBus, servo_id: int, block: Block[Any]) -> Steps[dict[Any, int]]:
    """Read the registers of a block of one servo, as a sequence; raises NoReply."""
    for attempt in range(STEP_ATTEMPTS):
        yield 0.0
        bus.counters.retries += attempt > 0
        frame = bus.sync_read((servo_id,), block.address, block.length).get(servo_id)
        if frame is not None:
            return block.parse(frame.data)
    raise NoReply(servo_id, STEP_ATTEMPTS)


def write_verified(bus: ServoBus, servo_id: int, register: RegisterEnum, value: int) -> Steps[None]:
    """Write a register until it reads back; raises StartupError for a servo that keeps another value, and NoReply."""
    error = 0
    for attempt in range(STEP_ATTEMPTS):
        yield 0.0
        bus.counters.retries += attempt > 0
        with contextlib.suppress(NoReply):
            error = bus.write(servo_id, register, value)
        if (yield from read(bus, servo_id, register)) == value:
            return
    reported = f", and reports error {error}" if error else ""
    raise StartupError(f"servo {servo_id} does not take {value} in register {register.name} ({register}){reported}")
