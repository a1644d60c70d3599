from __future__ import annotations

import contextlib
import json
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import Calibration
from robot.emulator.__main__ import build_servos
from robot.emulator.wire import Faults, Instruction, InstructionParser, ServoBus, status_packet
from robot.emulator.write_log import WriteLog
from robot.packets import checksum, parse_status_frames, sync_write_parameters
from robot.registers import GOAL_ADDRESS, Register, goal_block

PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x82, 0x83
ALL = 0xFE
IDS = [1, 2, 3, 4, 5, 6]


def packet(servo_id, code, parameters=()):
    body = bytes([servo_id, len(parameters) + 2, code, *parameters])
    return b"\xff\xff" + body + bytes([checksum(body)])


@pytest.fixture
def bus():
    return ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0)


def said(bus, data, now_s=0.0):
    return b"".join(reply.data for reply in bus.receive(data, now_s))


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


def test_an_instruction_with_a_wrong_checksum_is_not_obeyed(bus):
    good = packet(1, PING)
    assert said(bus, good[:-1] + bytes([good[-1] ^ 1])) == b""
    assert said(bus, good) == status_packet(1, 0)


def test_an_instruction_cut_off_does_not_swallow_a_later_one():
    parser = InstructionParser()
    assert parser.feed(packet(1, WRITE, bytes(60))[:10], 0.0) == []
    assert parser.feed(packet(2, PING), 0.1) == [Instruction(2, PING, b"")]


@given(st.binary(max_size=200))
def test_any_bytes_at_all_leave_the_servos_able_to_answer(data):
    bus = ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0)
    bus.receive(data, 0.0)
    bus.servos[0].write(Register.RETURN_DELAY, bytes([0]))
    assert status_packet(1, 0) in said(bus, packet(1, PING), 10.0)


def test_a_ping_is_answered_by_the_servo_named_and_a_broadcast_ping_by_all(bus):
    assert said(bus, packet(3, PING)) == status_packet(3, 0)
    assert said(bus, packet(9, PING)) == b""
    assert said(bus, packet(ALL, PING)) == b"".join(status_packet(i, 0) for i in IDS)


def test_a_sync_read_is_answered_in_the_order_asked(bus):
    reply = said(bus, packet(ALL, SYNC_READ, [Register.ID, 1, 5, 2, 9, 6]))
    assert reply == b"".join(status_packet(i, 0, bytes([i])) for i in (5, 2, 6))


def test_a_sync_write_is_taken_by_each_servo_and_answered_by_none(bus):
    goals = {i: goal_block(2000 + i, 700) for i in (1, 4)}
    assert said(bus, packet(ALL, SYNC_WRITE, sync_write_parameters(GOAL_ADDRESS, goals))) == b""
    assert [bus.servos[i - 1].value(Register.GOAL_POSITION) for i in (1, 2, 4)] == [2001, 0, 2004]


def test_a_write_is_acknowledged_unless_broadcast_or_told_otherwise(bus):
    assert said(bus, packet(2, WRITE, [Register.TORQUE_LIMIT, 100, 0])) == status_packet(2, 0)
    assert said(bus, packet(ALL, WRITE, [Register.TORQUE_ENABLE, 0])) == b""
    assert said(bus, packet(2, WRITE, [Register.RESPONSE_LEVEL, 0])) == b""
    assert said(bus, packet(2, READ, [Register.ID, 1])) == status_packet(2, 0, b"\x02")


def test_replies_are_due_when_their_last_byte_has_passed_the_wire(bus):
    (reply,) = bus.receive(packet(ALL, SYNC_READ, [56, 15, *IDS]), 5.0)
    assert reply.due_s - 5.0 == pytest.approx((14 + 6 * 21) * 10e-6 + 6 * 20e-6)


def test_the_return_delay_holds_up_each_reply(bus):
    (at_once,) = bus.receive(packet(1, PING), 1.0)
    bus.servos[0].write(Register.RETURN_DELAY, bytes([250]))
    (delayed,) = bus.receive(packet(1, PING), 2.0)
    assert (delayed.due_s - 2.0) - (at_once.due_s - 1.0) == pytest.approx(500e-6)


def test_an_instruction_sent_behind_another_waits_for_the_wire(bus):
    first, second = bus.receive(packet(1, PING) + packet(2, PING), 0.0)
    assert second.due_s - first.due_s == pytest.approx(12 * 10e-6 + 20e-6)


def test_a_servo_offline_neither_hears_nor_speaks(bus):
    bus.faults.offline.add(2)
    assert said(bus, packet(2, PING)) == b""
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    assert [servo.value(Register.TORQUE_ENABLE) for servo in bus.servos] == [1, 0, 1, 1, 1, 1]


@pytest.mark.parametrize(("drop", "corrupt"), [(0.3, 0.0), (0.0, 0.3)])
def test_replies_are_lost_or_damaged_as_often_as_asked_and_alike_for_a_seed(drop, corrupt):
    def good_replies():
        faults = Faults(drop, corrupt, random=random.Random(5))
        sent = status_packet(1, 0, bytes(15))
        return [faults.strike(sent) == sent for _ in range(1000)]

    assert sum(good_replies()) == pytest.approx(700, abs=60)
    assert good_replies() == good_replies()


@given(st.integers(0, 2**32))
def test_a_damaged_reply_is_never_taken_for_a_good_one(seed):
    faults = Faults(corrupt=1.0, random=random.Random(seed))
    assert parse_status_frames(faults.strike(status_packet(1, 0, bytes(15))), [1], 15) == {}


def test_servos_move_while_nobody_speaks(bus):
    bus.receive(packet(1, WRITE, [GOAL_ADDRESS, *goal_block(2500, 1000)]), 0.0)
    bus.receive(packet(1, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    for k in range(50):
        bus.advance(0.02 * k)
    assert bus.servos[0].present_ticks == 2500


def test_writes_are_recorded_and_nothing_else(tmp_path):
    path = tmp_path / "writes.jsonl"
    with contextlib.closing(WriteLog(path)) as log:
        bus = ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(offline={6}), 0.0, log)
        bus.receive(packet(1, PING) + packet(1, READ, [56, 2]) + packet(9, WRITE, [40, 0]), 1.0)
        bus.receive(packet(2, WRITE, [48, 1, 2]), 2.0)
        bus.receive(packet(ALL, WRITE, [40, 0]), 3.0)
        bus.receive(packet(ALL, SYNC_WRITE, [41, 1, 1, 254, 3, 100]), 4.0)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(line["t"], line["instruction"], line["address"], line["data"]) for line in lines] == [
        (2.0, "write", 48, {"2": [1, 2]}),
        (3.0, "write", 40, {str(i): [0] for i in IDS[:5]}),
        (4.0, "sync_write", 41, {"1": [254], "3": [100]}),
    ]
