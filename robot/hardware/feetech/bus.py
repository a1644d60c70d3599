"""Feetech's packets and bus; replies are distinguished by their length.

Instruction ``FF FF ID LEN INST P.. CHK``, status ``FF FF ID LEN ERR D.. CHK``; LEN counts the bytes behind it, CHK is
the inverted sum of everything from ID on (Feetech SCS/STS protocol).

Nothing in a reply identifies the instruction that it answers. So instructions are distinguished by the number of bytes
that they ask for: a single read asks for 3 to 14 bytes, another number each time, and uses the first one or two; a sync
read asks for at least 15, and after any disturbance for another number than before. A late or repeated reply then has
the wrong length for the present instruction and is skipped.
"""

import time
from collections.abc import Callable, Collection, Sequence
from functools import partial
from itertools import cycle

from scservo_sdk import INST_PING, PacketHandler

from robot.hardware.feetech.registers import TABLE
from robot.hardware.port import BusPort
from robot.hardware.servos.bus import BROADCAST_ID, MAX_BURST_BYTES, ServoBus, StatusFrame

HEADER = b"\xff\xff"

STATUS_OVERHEAD_BYTES = 6  # bytes of a status packet besides its data: header, id, LEN, ERR, checksum
LENGTH_OVERHEAD = 2  # bytes that follow LEN besides the data: ERR and checksum
MAX_INSTRUCTION_BYTES = 250  # the SDK's limit
INSTRUCTION_OVERHEAD_BYTES = 6  # bytes of an instruction besides its parameters: header, id, LEN, INST, checksum


def checksum(body: bytes) -> int:
    """Compute the checksum of everything between header and checksum."""
    return ~sum(body) & 0xFF


def instruction_packet(servo_id: int, instruction: int, parameters: Sequence[int] = ()) -> list[int]:
    """Build an instruction for ``txPacket``, which adds header and checksum; raises ValueError if it is too long."""
    most = MAX_INSTRUCTION_BYTES - INSTRUCTION_OVERHEAD_BYTES
    if len(parameters) > most:
        raise ValueError(f"an instruction has at most {most} bytes of parameters, not {len(parameters)}")
    return [0, 0, servo_id, len(parameters) + LENGTH_OVERHEAD, instruction, *parameters, 0]


def status_bytes(data_length: int, replies: int = 1) -> int:
    """Count the bytes of ``replies`` status packets with ``data_length`` bytes of data each."""
    return replies * (data_length + STATUS_OVERHEAD_BYTES)


def parse_status_frames(received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
    """Find the replies of the expected servos, in their order, in the bytes received since the instruction, by id.

    A frame counts only if its header, id, LEN and checksum fit, it contains no start of another reply (the sign of a
    truncated frame that swallowed its neighbour), it is followed by another header or nothing, its servo has not sent a
    different one, and it is in turn: of two frames in the wrong order either may have a disturbed id, so both are left
    out. Noise between frames is skipped.
    """
    frames: dict[int, StatusFrame] = {}
    contradicted: set[int] = set()
    at = received.find(HEADER)
    while at >= 0:
        frame = _frame_at(received, at, expected_ids, data_length)
        if frame is None:
            at = received.find(HEADER, at + 1)
            continue
        if frames.setdefault(frame.servo_id, frame) != frame:
            contradicted.add(frame.servo_id)
        at = received.find(HEADER, at + status_bytes(data_length))
    doubted = contradicted | _out_of_turn(list(frames), expected_ids)
    return {servo_id: frame for servo_id, frame in frames.items() if servo_id not in doubted}


def _out_of_turn(ids: Sequence[int], expected_ids: Sequence[int]) -> set[int]:
    turns = [expected_ids.index(servo_id) for servo_id in ids]
    if turns == sorted(turns):
        return set()
    return {
        servo_id
        for place, servo_id in enumerate(ids)
        if any(turn > turns[place] for turn in turns[:place]) or any(turn < turns[place] for turn in turns[place + 1 :])
    }


def _frame_at(received: bytes, at: int, expected_ids: Collection[int], data_length: int) -> StatusFrame | None:
    end = at + status_bytes(data_length)
    if end > len(received):
        return None
    body = received[at + 2 : end - 1]
    servo_id, length, error, data = body[0], body[1], body[2], body[3:]
    if servo_id not in expected_ids or length != data_length + LENGTH_OVERHEAD:
        return None
    if received[end - 1] != checksum(body) or _holds_header(body[2:], expected_ids, length):
        return None
    if received[end : end + 1] not in (b"", HEADER[:1]):
        return None
    return StatusFrame(servo_id, error, data)


def _holds_header(payload: bytes, expected_ids: Collection[int], length: int) -> bool:
    at = payload.find(HEADER)
    while at >= 0:
        start = payload[at + 2 : at + 4]
        if len(start) == 2 and start[0] in expected_ids and start[1] == length:
            return True
        at = payload.find(HEADER, at + 1)
    return False


READ_LENGTHS = range(3, 15)  # lengths of single reads, all longer than any register and shorter than any sync read

# Sync reads ask for this many bytes at least, and for up to SYNC_READ_PADDINGS - 1 steps more while the line
# is disturbed: a reply would have to come sixteen failed reads (over 70 ms) late to be taken for a new one.
SYNC_READ_MIN_LENGTH = 15
SYNC_READ_PADDINGS = 16

# The telemetry block has 15 bytes and the control block 16: even paddings keep their lengths apart, always.
SYNC_READ_PADDING_STEP = 2

CALM_S = 1.0  # no reply is this late: a line undisturbed for so long is safe without padding
SERVO_IDS = range(254)  # ids that a servo can have; 254 is the broadcast

# Every servo replies to a broadcast ping after the time slots of those with lower ids. No document states the length of
# a slot; lerobot waits 3 ms for each of 252 ids.
PING_SLOT_S = 0.003

LITTLE_ENDIAN = 0


class Bus(ServoBus):
    """Bus of any number of Feetech servos."""

    registers = TABLE
    _make_sdk = staticmethod(partial(PacketHandler, LITTLE_ENDIAN))
    _packet = staticmethod(instruction_packet)
    _parse_replies = staticmethod(parse_status_frames)
    _reply_bytes = staticmethod(status_bytes)

    def __init__(self, port: BusPort, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(port, clock)
        self._disturbed_s = self._last_byte_s
        self._read_lengths = cycle(READ_LENGTHS)
        self._padding = 0
        self._padding_is_safe = True

    def broadcast_ping(self) -> dict[int, int]:
        """Ping all servos for 0.8 s; return each reply's error byte by id. Replies of one id collide: discarded."""
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

    def sync_read(self, ids: Sequence[int], address: int, length: int) -> dict[int, StatusFrame]:
        """Read the same block of several servos, asking for a length that no late reply has."""
        self._await_quiet()
        asked_length = max(length, SYNC_READ_MIN_LENGTH) + self._choose_padding()
        frames = self._exchange(self._sync_read_packet(ids, address, asked_length), ids, asked_length)
        if asked_length == length:
            return frames
        return {servo_id: StatusFrame(servo_id, frame.error, frame.data[:length]) for servo_id, frame in frames.items()}

    def _read_length(self, size: int) -> int:
        return next(self._read_lengths)

    def _note_disturbance(self) -> None:
        super()._note_disturbance()
        self._disturbed_s = self._clock()
        self._padding_is_safe = False

    def _choose_padding(self) -> int:
        if self._clock() - self._disturbed_s > CALM_S:
            self._padding = 0
        elif not self._padding_is_safe:
            self._padding = (self._padding + 1) % SYNC_READ_PADDINGS
        self._padding_is_safe = True
        return self._padding * SYNC_READ_PADDING_STEP
