from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import Calibration
from robot.emulator.arm import build_servos
from robot.emulator.faults import Faults
from robot.emulator.servo_bus import BAUDRATES, ServoBus
from robot.emulator.wire import status_packet
from robot.emulator.write_log import WriteLog
from robot.servos.packets import checksum
from robot.servos.registers import GOAL_ADDRESS, Register, goal_block

PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x82, 0x83
ALL = 0xFE
IDS = [1, 2, 3, 4, 5, 6]


def packet(servo_id, code, parameters=()):
    body = bytes([servo_id, len(parameters) + 2, code, *parameters])
    return b"\xff\xff" + body + bytes([checksum(body)])


BLOCK_READ = packet(ALL, SYNC_READ, [56, 15, *IDS])


def bus_with(faults=None, log=None):
    return ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), faults or Faults(), 0.0, log)


@pytest.fixture
def bus():
    return bus_with()


def said(bus, data, now_s=0.0, baudrate=1_000_000):
    return b"".join(reply.data for reply in bus.receive(data, now_s, baudrate))


@given(st.binary(max_size=200))
def test_any_bytes_at_all_leave_the_servos_able_to_answer(data):
    bus = bus_with()
    bus.receive(data, 0.0)
    servo = bus.servos[0]
    servo.write(Register.RETURN_DELAY, bytes([0]))
    servo.write(Register.BAUD_RATE, bytes([0]))
    assert status_packet(servo.servo_id, servo.error) in said(bus, packet(servo.servo_id, PING), 10.0)


def test_an_instruction_with_a_wrong_checksum_is_not_obeyed(bus):
    good = packet(1, PING)
    assert said(bus, good[:-1] + bytes([good[-1] ^ 1])) == b""
    assert said(bus, good) == status_packet(1, 0)


def test_replies_are_due_when_their_last_byte_has_passed_the_wire(bus):
    replies = bus.receive(BLOCK_READ, 5.0)
    assert [reply.due_s - 5.0 for reply in replies] == pytest.approx(
        [14 * 10e-6 + (k + 1) * (21 * 10e-6 + 20e-6) for k in range(6)]
    )


def test_the_return_delay_holds_up_each_reply(bus):
    (at_once,) = bus.receive(packet(1, PING), 1.0)
    bus.servos[0].write(Register.RETURN_DELAY, bytes([250]))
    (delayed,) = bus.receive(packet(1, PING), 2.0)
    assert (delayed.due_s - 2.0) - (at_once.due_s - 1.0) == pytest.approx(500e-6)


def test_instructions_that_come_together_are_answered_one_after_the_other(bus):
    first, second = bus.receive(packet(1, PING) + packet(2, PING), 0.0)
    assert second.due_s - first.due_s == pytest.approx(12 * 10e-6 + 20e-6)


def test_who_talks_over_replies_is_not_heard_and_loses_them(bus):
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    replies = bus.receive(BLOCK_READ, 1.0)
    whole = [reply.data for reply in replies]
    now_s = replies[2].start_s + 5 * 10e-6 + 1e-9
    assert said(bus, packet(ALL, WRITE, [Register.TORQUE_ENABLE, 0]), now_s) == b""
    assert {servo.value(Register.TORQUE_ENABLE) for servo in bus.servos} == {1}
    assert [reply.data for reply in replies] == [*whole[:2], whole[2][:5], b"", b"", b""]


def test_who_talks_when_the_replies_are_over_is_heard(bus):
    replies = bus.receive(BLOCK_READ, 1.0)
    assert said(bus, packet(1, PING), replies[-1].end_s) == status_packet(1, 0)
    assert all(len(reply.data) == 21 for reply in replies)


def test_a_servo_offline_neither_hears_nor_speaks(bus):
    bus.faults.offline.add(2)
    assert said(bus, packet(2, PING)) == b""
    bus.receive(packet(ALL, WRITE, [Register.TORQUE_ENABLE, 1]), 0.0)
    assert [servo.value(Register.TORQUE_ENABLE) for servo in bus.servos] == [1, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("code", sorted(BAUDRATES))
def test_a_servo_hears_only_at_its_own_baud_rate(bus, code):
    bus.servos[2].write(Register.BAUD_RATE, bytes([code]))
    heard_at = [rate for rate in BAUDRATES.values() if said(bus, packet(3, PING), float(rate), rate)]
    assert heard_at == [BAUDRATES[code]]


def test_a_lost_instruction_is_neither_obeyed_nor_answered():
    bus = bus_with(Faults(lose_instruction=1.0))
    assert said(bus, packet(1, WRITE, [Register.TORQUE_ENABLE, 1])) == b""
    assert bus.servos[0].value(Register.TORQUE_ENABLE) == 0


def test_a_delayed_reply_has_passed_the_wire_and_holds_up_those_behind_it():
    bus = bus_with(Faults(delay=1.0, delay_s=0.05))
    (late,) = bus.receive(packet(1, PING), 0.0)
    assert late.due_s - late.end_s == pytest.approx(0.05)
    bus.faults.delay = 0.0
    (behind,) = bus.receive(packet(2, PING), 0.01)
    assert behind.data == status_packet(2, 0)
    assert behind.end_s < late.due_s <= behind.due_s


def test_servos_move_while_nobody_speaks(bus):
    bus.receive(packet(1, WRITE, [GOAL_ADDRESS, *goal_block(2500, 1000)]), 0.0)
    bus.receive(packet(1, WRITE, [Register.TORQUE_ENABLE, 1]), 0.01)
    for k in range(50):
        bus.advance(0.02 * k)
    assert bus.servos[0].present_ticks == 2500


def test_the_weight_is_put_on_at_once_and_again_as_the_arm_moves():
    times = []
    bus = ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0, weigh=lambda: times.append(1))
    assert len(times) == 1
    for k in range(1, 101):
        bus.advance(0.001 * k)
    assert 9 <= len(times) <= 12


def test_writes_and_commands_are_recorded_and_nothing_else(tmp_path):
    path = tmp_path / "writes.jsonl"
    with contextlib.closing(WriteLog(path)) as log:
        bus = bus_with(Faults(offline={6}), log)
        bus.receive(packet(1, PING) + packet(1, READ, [56, 2]) + packet(9, WRITE, [40, 0]), 1.0)
        bus.receive(packet(2, WRITE, [48, 1, 2]), 2.0)
        bus.receive(packet(ALL, WRITE, [40, 0]), 3.0)
        bus.receive(packet(ALL, SYNC_WRITE, [41, 1, 1, 254, 3, 100]), 4.0)
        bus.record_command({"push": {"3": 1}})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(line["t"], line["instruction"], line["address"], line["data"]) for line in lines] == [
        (2.0, "write", 48, {"2": [1, 2]}),
        (3.0, "write", 40, {str(i): [0] for i in IDS[:5]}),
        (4.0, "sync_write", 41, {"1": [254], "3": [100]}),
        (4.0, "command", None, {}),
    ]
