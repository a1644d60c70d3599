"""Feetech's bus: packets of ``scservo_sdk``, and replies that are distinguished by their length.

Nothing in a reply identifies the instruction that it answers. So instructions are distinguished by the number of bytes
that they ask for:

* A single read asks for 3 to 14 bytes, another number each time, and uses the first one or two.
* A sync read asks for at least 15, and after any disturbance for another number than before.

A late or repeated reply then has the wrong length for the present instruction and is skipped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle

from scservo_sdk import INST_PING, PacketHandler

from robot.hardware.feetech.packets import (
    StatusFrame,
    instruction_packet,
    parse_status_frames,
    status_bytes,
)
from robot.hardware.feetech.registers import TABLE
from robot.hardware.port import BusPort
from robot.hardware.servos.bus import BROADCAST_ID, MAX_BURST_BYTES, ServoBus

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
        """Ping all servos, which takes 0.8 s; return the error byte of each servo with a valid reply, by id.

        Two servos with the same id reply at once: their bytes count as ``discarded_bytes``.
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

    def sync_read(self, ids: Sequence[int], address: int, length: int) -> dict[int, StatusFrame]:
        """Read the same block of several servos, asking for a length that no late reply has."""
        self._await_quiet()
        asked_length = max(length, SYNC_READ_MIN_LENGTH) + self._choose_padding()
        frames = self._exchange(self._sync_read_packet(ids, address, asked_length), ids, asked_length)
        if asked_length == length:
            return frames
        return {servo_id: StatusFrame(servo_id, frame.error, frame.data[:length]) for servo_id, frame in frames.items()}

    def _read_length(self, size: int) -> int:  # noqa: ARG002 - longer than any register
        return next(self._read_lengths)

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
