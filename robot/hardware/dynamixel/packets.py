"""Packets of Dynamixel's protocol 2.0: instructions built, status packets parsed. Pure, without a port.

Instruction ``FF FF FD 00 ID LEN LEN INST P.. CRC CRC``, status ``FF FF FD 00 ID LEN LEN 55 ERR P.. CRC CRC``; LEN
counts what follows it, little endian. Behind every ``FF FF FD`` from INST to the last parameter one more ``FD`` is
stuffed, so that no header can be in a packet; LEN and CRC count the stuffed bytes (e-manual, DYNAMIXEL Protocol 2.0).
"""

from __future__ import annotations

from collections.abc import Sequence

from dynamixel_sdk import INST_STATUS

from robot.hardware.servos.bus import StatusFrame as StatusFrame

HEADER = b"\xff\xff\xfd\x00"
_HEADER_IN_BODY = b"\xff\xff\xfd"
_STUFFED = b"\xff\xff\xfd\xfd"

PREFIX_BYTES = 7  # header, id and LEN: what LEN does not count
LENGTH_OVERHEAD = 3  # INST and CRC; a status packet has ERR as well
STATUS_OVERHEAD_BYTES = 11  # bytes of a status packet besides its data: header, id, LEN, INST, ERR, CRC

# Bit of ERR: HARDWARE_ERROR_STATUS is not 0. The other bits are the number of an error of the instruction.
ALERT = 0x80

MAX_PACKET_BYTES = 1024  # longest packet of the SDK

CRC_POLYNOMIAL = 0x8005


def _crc_of_byte(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1 ^ CRC_POLYNOMIAL if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


_CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes) -> int:
    """Compute the CRC of a packet's bytes before it: polynomial 0x8005, initial value 0, not reflected."""
    crc = 0
    for byte in data:
        crc = crc << 8 & 0xFF00 ^ _CRC_TABLE[crc >> 8 ^ byte]
    return crc


def packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Build a whole packet."""
    body = bytes([instruction]) + parameters
    body = body.replace(_HEADER_IN_BODY, _STUFFED)
    head = HEADER + bytes([servo_id]) + (len(body) + LENGTH_OVERHEAD - 1).to_bytes(2, "little") + body
    return head + crc16(head).to_bytes(2, "little")


def instruction_packet(servo_id: int, instruction: int, parameters: Sequence[int] = ()) -> list[int]:
    """Build an instruction for ``txPacket`` of ``dynamixel_sdk``, which adds header and CRC.

    Raises ValueError for a longer packet than the SDK sends, and for a packet that needs a stuffed byte: version 4.1.0
    computes it and sends the packet without it.
    """
    size = PREFIX_BYTES + LENGTH_OVERHEAD + len(parameters)
    if size > MAX_PACKET_BYTES:
        raise ValueError(f"a packet has at most {MAX_PACKET_BYTES} bytes, not {size}")
    if _HEADER_IN_BODY in bytes(parameters):
        raise ValueError("an instruction must not have the bytes of a header, FF FF FD, among its parameters")
    length = len(parameters) + LENGTH_OVERHEAD
    return [0, 0, 0, 0, servo_id, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]


def status_bytes(data_length: int, replies: int = 1) -> int:
    """Count the bytes of ``replies`` status packets with ``data_length`` bytes of data each, without stuffing."""
    return replies * (data_length + STATUS_OVERHEAD_BYTES)


def stuffed_bytes(received: bytes) -> int:
    """Count the stuffed bytes among those received."""
    return received.count(_STUFFED)


def parse_status_frames(received: bytes, expected_ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
    """Find the replies of the expected servos in the bytes received since the instruction, by id.

    A frame counts only if its header, id, LEN, INST and CRC fit, and its servo has not sent a different one. Noise
    between frames is skipped. A reply that reports an error of the instruction has no data, so that it counts only
    where none is expected.
    """
    frames: dict[int, StatusFrame] = {}
    contradicted: set[int] = set()
    at = received.find(HEADER)
    while at >= 0:
        frame, end = _frame_at(received, at)
        expected = frame is not None and frame.servo_id in expected_ids and len(frame.data) == data_length
        if frame is not None and expected and frames.setdefault(frame.servo_id, frame) != frame:
            contradicted.add(frame.servo_id)
        at = received.find(HEADER, end)
    return {servo_id: frame for servo_id, frame in frames.items() if servo_id not in contradicted}


def _frame_at(received: bytes, at: int) -> tuple[StatusFrame | None, int]:
    """Parse the packet whose header is at ``at``; return it, None if it is invalid, and the end of what was used."""
    length_at = at + len(HEADER) + 1
    end = at + PREFIX_BYTES + int.from_bytes(received[length_at : length_at + 2], "little")
    whole = received[at:end]
    if end > len(received) or len(whole) < STATUS_OVERHEAD_BYTES or whole[PREFIX_BYTES] != INST_STATUS:
        return None, at + 1
    if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
        return None, at + 1
    body = whole[PREFIX_BYTES:-2].replace(_STUFFED, _HEADER_IN_BODY)
    return StatusFrame(whole[len(HEADER)], body[1], body[2:]), end
