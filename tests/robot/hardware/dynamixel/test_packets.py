from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from dynamixel_sdk import COMM_SUCCESS, INST_PING, INST_READ, INST_WRITE, PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.dynamixel import DYNAMIXEL
from robot.hardware.dynamixel.packets import (
    StatusFrame,
    instruction_packet,
    packet,
    parse_status_frames,
    status_bytes,
    stuffed_bytes,
)


# Examples of the e-manual, DYNAMIXEL Protocol 2.0: Ping, Read, Write, Sync Read and Reboot.
@pytest.mark.parametrize(
    ("built", "wire"),
    [
        (packet(1, INST_PING), "fffffd00 01 0300 01 194e"),
        (packet(254, INST_PING), "fffffd00 fe 0300 01 3142"),
        (packet(1, INST_READ, bytes([132, 0, 4, 0])), "fffffd00 01 0700 02 84000400 1d15"),
        (packet(1, INST_WRITE, bytes([116, 0, 0, 2, 0, 0])), "fffffd00 01 0900 03 740000020000 ca89"),
        (packet(254, 0x82, bytes([132, 0, 4, 0, 1, 2])), "fffffd00 fe 0900 82 840004000102 cefa"),
        (packet(1, 0x08), "fffffd00 01 0300 08 2f4e"),
        (DYNAMIXEL.status_packet(1, 0, bytes([0x06, 0x04, 0x26])), "fffffd00 01 0700 55 00060426 655d"),
        (DYNAMIXEL.status_packet(2, 0, (2079).to_bytes(4, "little")), "fffffd00 02 0800 55 001f080000 babe"),
    ],
)
def test_packets_are_those_of_the_manual(built: bytes, wire: str) -> None:
    assert built == bytes.fromhex(wire)


class Sent:
    """The SDK's port, which keeps what is written."""

    def __init__(self) -> None:
        self.is_using = False
        self.data = b""

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        return

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        self.data = bytes(packet)
        return len(packet)


@given(st.integers(0, 252), st.sampled_from([1, 2, 3, 8, 0x82, 0x83]), st.binary(max_size=60))
def test_the_sdk_sends_what_is_built_here(servo_id: int, code: int, parameters: bytes) -> None:
    if b"\xff\xff\xfd" in parameters:
        return
    port = Sent()
    assert PacketHandler(2.0).txPacket(port, instruction_packet(servo_id, code, parameters)) == COMM_SUCCESS
    assert port.data == packet(servo_id, code, parameters)


def test_what_the_sdk_would_send_without_its_stuffed_byte_is_refused() -> None:
    with pytest.raises(ValueError, match="FF FF FD"):
        instruction_packet(1, INST_WRITE, [116, 0, 0xFF, 0xFF, 0xFD, 0xFF])


def test_a_packet_longer_than_the_sdk_sends_is_refused() -> None:
    with pytest.raises(ValueError, match="1024"):
        instruction_packet(1, INST_WRITE, [0] * 1015)


# Bytes that have headers, and almost headers, among them.
HEADERS = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x12]), max_size=24).map(bytes)


@given(HEADERS, st.integers(0, 255))
def test_any_data_arrives_as_they_were_sent(data: bytes, error: int) -> None:
    received = DYNAMIXEL.status_packet(3, error, data)
    assert parse_status_frames(received, (3,), len(data)) == {3: StatusFrame(3, error, data)}
    assert len(received) - stuffed_bytes(received) == status_bytes(len(data))


@given(HEADERS)
def test_no_packet_has_a_header_but_its_own(data: bytes) -> None:
    assert DYNAMIXEL.status_packet(3, 0, data).count(b"\xff\xff\xfd\x00") == 1


REPLIES = b"".join(DYNAMIXEL.status_packet(servo, 0, bytes([servo] * 4)) for servo in (1, 2, 3))


def test_a_damaged_byte_never_changes_a_reading() -> None:
    for at, flip in itertools.product(range(len(REPLIES)), (0x01, 0x80, 0xFF)):
        damaged = REPLIES[:at] + bytes([REPLIES[at] ^ flip]) + REPLIES[at + 1 :]
        frames = parse_status_frames(damaged, (1, 2, 3), 4)
        assert frames, (at, flip)
        assert all(frame == StatusFrame(servo, 0, bytes([servo] * 4)) for servo, frame in frames.items()), (at, flip)


def reply(servo: int, data: bytes = b"ab") -> bytes:
    return DYNAMIXEL.status_packet(servo, 0, data)


STREAMS = {
    "noise between replies": (b"\xff\xff\x00" + reply(1) + b"\xfd\xff" + reply(2), {1, 2}),
    "another servo, and another length": (reply(5) + reply(1, b"abc") + reply(2), {2}),
    "a servo that contradicts itself": (reply(1) + reply(1, b"ac") + reply(2), {2}),
    "the host's own instruction": (packet(1, INST_WRITE, b"abc"), set()),
    **{f"cut off after {end} bytes": (reply(1)[:end], set()) for end in range(len(reply(1)))},
}


def test_only_whole_replies_of_those_who_were_asked_are_believed() -> None:
    for name, (received, believed) in STREAMS.items():
        assert set(parse_status_frames(received, (1, 2), 2)) == believed, name
