"""Packets of the servo bus: instructions built, status packets parsed. Pure, without a port.

Instruction ``FF FF ID LEN INST P.. CHK``, status ``FF FF ID LEN ERR D.. CHK``; LEN counts what follows it,
CHK is the inverted sum of everything from ID on (Feetech SCS/STS protocol).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from robot.hardware.servos.bus import StatusFrame as StatusFrame

HEADER = b"\xff\xff"

# Bytes of a status packet besides its data: header, id, LEN, ERR, checksum.
STATUS_OVERHEAD_BYTES = 6

# Low byte of the sum of all that follows the header: the checksum is the inverse of what precedes it.
SOUND_SUM = 0xFF

# Bytes that follow LEN besides the data: ERR and checksum.
LENGTH_OVERHEAD = 2

# The SDK's limit.
MAX_INSTRUCTION_BYTES = 250

# Bytes of an instruction besides its parameters: header, id, LEN, INST, checksum.
INSTRUCTION_OVERHEAD_BYTES = 6


def checksum(body: bytes) -> int:
    """Compute the checksum of everything between header and checksum."""
    return ~sum(body) & 0xFF


def instruction_packet(servo_id: int, instruction: int, parameters: Sequence[int] = ()) -> list[int]:
    """Build an instruction for ``txPacket`` of ``scservo_sdk``, which adds header and checksum.

    Raises ValueError for a longer packet than the SDK sends.
    """
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
    frames = _parse_clean(received, expected_ids, data_length)
    return _parse_disturbed(received, expected_ids, data_length) if frames is None else frames


def _parse_clean(received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame] | None:
    """Parse the replies of all servos in turn; return None if anything else could be among or in them."""
    size = status_bytes(data_length)
    # As many headers as replies: none is hidden in the data.
    if len(received) != size * len(expected_ids) or received.count(HEADER) != len(expected_ids):
        return None
    frames = {}
    for at, servo_id in zip(range(0, len(received), size), expected_ids, strict=True):
        packet = received[at : at + size]
        header, body = packet[:2], packet[2:]
        if header != HEADER or body[0] != servo_id or body[1] != data_length + LENGTH_OVERHEAD:
            return None
        if sum(body) & 0xFF != SOUND_SUM:
            return None
        frames[servo_id] = StatusFrame(servo_id, body[2], body[3:-1])
    return frames


def _parse_disturbed(received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
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
