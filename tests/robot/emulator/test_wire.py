from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.servo_bus import Instruction, InstructionParser, status_packet
from robot.hardware.feetech.packets import checksum, parse_status_frames

PING, WRITE = 1, 3
ALL = 0xFE


def packet(servo_id, code, parameters=()):
    body = bytes([servo_id, len(parameters) + 2, code, *parameters])
    return b"\xff\xff" + body + bytes([checksum(body)])


INSTRUCTIONS = st.builds(Instruction, st.integers(0, ALL), st.integers(1, 0x83), st.binary(max_size=60))


@given(st.lists(INSTRUCTIONS, max_size=4), st.lists(st.integers(1, 40), max_size=20))
def test_instructions_are_the_same_however_their_bytes_are_cut(instructions, cuts):
    stream = b"".join(packet(i.servo_id, i.code, i.parameters) for i in instructions)
    parser, parsed = InstructionParser(), []
    for count in [*cuts, len(stream)]:
        parsed += parser.feed(stream[:count], 0.0)
        stream = stream[count:]
    assert parsed == instructions


@given(st.lists(st.integers(0, 0xFE), max_size=60).map(bytes), INSTRUCTIONS)
def test_noise_before_an_instruction_is_skipped(noise, instruction):
    sent = packet(instruction.servo_id, instruction.code, instruction.parameters)
    assert InstructionParser().feed(noise + sent, 0.0) == [instruction]


def test_an_instruction_with_a_wrong_checksum_is_skipped():
    good = packet(1, PING)
    assert InstructionParser().feed(good[:-1] + bytes([good[-1] ^ 1]) + good, 0.0) == [Instruction(1, PING, b"")]


@given(st.integers(0, 0xFD), st.integers(0, 63), st.binary(max_size=40))
def test_a_status_packet_is_read_by_the_drivers_own_parser(servo_id, error, data):
    frames = parse_status_frames(status_packet(servo_id, error, data), [servo_id], len(data))
    assert not frames or (frames[servo_id].error, frames[servo_id].data) == (error, data)


def test_an_instruction_cut_off_does_not_swallow_a_later_one():
    parser = InstructionParser()
    assert parser.feed(packet(1, WRITE, bytes(60))[:10], 0.0) == []
    assert parser.feed(packet(2, PING), 0.1) == [Instruction(2, PING, b"")]
