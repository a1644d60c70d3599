from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import InstructionParser
from robot.hardware.feetech.bus import (
    MAX_INSTRUCTION_BYTES,
    StatusFrame,
    checksum,
    instruction_packet,
    parse_status_frames,
)

IDS = (1, 2, 3)
LENGTH = 15
BLOCK = st.binary(min_size=LENGTH, max_size=LENGTH)
PLAIN_BLOCK = st.lists(st.integers(0, 0xFE), min_size=LENGTH, max_size=LENGTH).map(bytes)
NOISE = st.binary(max_size=12)


def frames_of(stream):
    return parse_status_frames(stream, IDS, LENGTH)


@given(st.lists(PLAIN_BLOCK, min_size=3, max_size=3), st.integers(0, 0x7F))
def test_replies_on_a_clean_line_all_arrive_with_their_error_byte(blocks, error):
    stream = b"".join(FEETECH.status_packet(i, error, block) for i, block in zip(IDS, blocks, strict=True))
    assert frames_of(stream) == {i: StatusFrame(i, error, block) for i, block in zip(IDS, blocks, strict=True)}


def test_a_reply_that_holds_the_start_of_another_is_not_believed_though_all_have_answered():
    holding = (b"\xff\xff" + bytes([2, LENGTH + 2])).ljust(LENGTH, b"\0")
    stream = (
        FEETECH.status_packet(1, 0, holding)
        + FEETECH.status_packet(2, 0, bytes(LENGTH))
        + FEETECH.status_packet(3, 0, bytes(LENGTH))
    )
    assert list(frames_of(stream)) == [2, 3]


@given(st.lists(BLOCK, min_size=3, max_size=3), st.integers(0, 0xFF))
def test_replies_read_the_same_whether_or_not_noise_precedes_them(blocks, error):
    stream = b"".join(FEETECH.status_packet(i, error, block) for i, block in zip(IDS, blocks, strict=True))
    assert frames_of(stream) == frames_of(b"\x00" + stream)


@st.composite
def damaged_streams(draw):
    """The replies of three servos, each lost, damaged, cut, repeated or whole, and noise before whole ones."""
    truth = {i: FEETECH.status_packet(i, 0, draw(BLOCK)) for i in IDS}
    stream = b""
    for packet in truth.values():
        match draw(st.sampled_from(["whole", "noise", "lost", "damaged", "cut", "repeated", "foreign"])):
            case "whole":
                stream += packet
            case "noise":
                stream += draw(NOISE) + packet
            case "damaged":
                at = draw(st.integers(0, len(packet) - 1))
                stream += packet[:at] + bytes([packet[at] ^ draw(st.integers(1, 255))]) + packet[at + 1 :]
            case "cut":
                stream += packet[: draw(st.integers(0, len(packet) - 1))]
            case "repeated":
                stream += packet + packet
            case "foreign":
                stream += FEETECH.status_packet(9, 0, draw(BLOCK)) + packet
    return truth, stream


@given(damaged_streams())
def test_no_reply_taken_from_a_damaged_line_is_wrong(case):
    truth, stream = case
    for servo_id, frame in frames_of(stream).items():
        assert FEETECH.status_packet(servo_id, frame.error, frame.data) == truth[servo_id]


def test_a_cut_reply_does_not_swallow_the_start_of_its_neighbour():
    # Cut by two bytes, so that the neighbour's FF FF stands for the last data byte and for a checksum that then fits.
    body = bytes([1, LENGTH + 2, 0]) + bytes(14)
    missing = next(byte for byte in range(256) if checksum(body[:-1] + bytes([byte, 0xFF])) == 0xFF)
    cut = b"\xff\xff" + body[:-1] + bytes([missing])
    neighbour = FEETECH.status_packet(2, 0, bytes(LENGTH))
    assert frames_of(cut + neighbour) == {2: StatusFrame(2, 0, bytes(LENGTH))}


def reply(servo_id, data=None):
    return FEETECH.status_packet(servo_id, 0, bytes([servo_id] * LENGTH) if data is None else data)


LYING = bytes([1, LENGTH + 3, 0]) + bytes(LENGTH)
STREAMS = {
    **{f"only {count} bytes of a reply": (reply(1)[:count], []) for count in range(len(reply(1)))},
    "another length": (reply(1, bytes(LENGTH - 1)), []),
    "a servo that contradicts itself": (reply(1) + reply(1, bytes(LENGTH)), []),
    "a repeated reply": (reply(1) * 2, [1]),
    "servo 1 as 3, and 3 itself unheard": (reply(3, bytes([1] * LENGTH)) + reply(2), []),
    "one missing between": (reply(1) + reply(3), [1, 3]),
    "a lie about its length": (b"\xff\xff" + LYING + bytes([checksum(LYING)]), []),
    **{
        f"noise like a header of {count} bytes": (b"\xff\xff\x01\x11\x00"[:count] + reply(2), [2])
        for count in range(1, 6)
    },
}


def test_only_whole_replies_in_their_turn_are_believed():
    for name, (stream, believed) in STREAMS.items():
        assert list(frames_of(stream)) == believed, name


@given(st.integers(0, 0xFD), st.integers(1, 0x83), st.binary(max_size=60))
def test_an_instruction_is_laid_out_as_the_servos_read_it(servo_id, code, parameters):
    packet = instruction_packet(servo_id, code, parameters)
    packet[:2] = [0xFF, 0xFF]
    packet[-1] = checksum(bytes(packet[2:-1]))
    (read,) = InstructionParser(FEETECH).feed(bytes(packet), 0.0)
    assert (read.servo_id, read.code, read.parameters) == (servo_id, code, parameters)


def test_an_instruction_longer_than_the_sdk_sends_is_refused():
    longest = MAX_INSTRUCTION_BYTES - 6
    assert len(instruction_packet(1, 3, bytes(longest))) == MAX_INSTRUCTION_BYTES
    with pytest.raises(ValueError, match=f"at most {longest} bytes"):
        instruction_packet(1, 3, bytes(longest + 1))


def test_a_cut_reply_whose_checksum_fits_by_chance_shows_its_neighbours_header():
    cut = b"\xff\xff" + bytes([1, LENGTH + 2, 0]) + bytes(9)
    start = b"\xff\xff" + bytes([2, LENGTH + 2, 0, 0])
    fitting = checksum(cut[2:] + start)
    neighbour = FEETECH.status_packet(2, 0, bytes([0, fitting, 0xFF]) + bytes(LENGTH - 3))
    assert frames_of(cut + neighbour) == {2: StatusFrame(2, 0, neighbour[5:-1])}
