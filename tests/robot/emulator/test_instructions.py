from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.arm import build_servos
from robot.emulator.servo_bus import Instruction, InstructionParser, execute, status_packet
from robot.hardware.feetech.packets import parse_status_frames, sync_write_parameters
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register, encode, goal_block
from tests.helpers.emulator import (
    ACTION,
    ALL,
    BACKUP,
    CALIBRATE,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    RESTORE,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    packet,
)
from tests.helpers.robots import nominal_calibration

RESET = 10


@pytest.fixture
def servos():
    return build_servos(nominal_calibration(), [0.0] * 6)


def do(servos, servo_id, code, parameters=(), **how):
    return execute(Instruction(servo_id, code, bytes(parameters)), servos, **how)


def answers(effects):
    return [(answer.servo.servo_id, answer.data) for effect in effects for answer in effect.answers]


@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=60))
def test_any_instruction_is_carried_out_without_an_exception(servo_id, code, parameters):
    execute(Instruction(servo_id, code, parameters), build_servos(nominal_calibration(), [0.0] * 6))


def test_a_ping_is_answered_by_the_servo_named_and_a_broadcast_ping_by_all(servos):
    assert answers(do(servos, 3, PING)) == [(3, b"")]
    assert answers(do(servos, 9, PING)) == []
    assert answers(do(servos, ALL, PING)) == [(i, b"") for i in range(1, 7)]


def test_a_read_is_answered_and_a_broadcast_read_by_none(servos):
    assert answers(do(servos, 2, READ, [Register.ID, 1])) == [(2, b"\x02")]
    assert answers(do(servos, ALL, READ, [Register.ID, 1])) == []


def test_a_sync_read_is_answered_in_the_order_asked(servos):
    assert answers(do(servos, ALL, SYNC_READ, [Register.ID, 1, 5, 2, 9, 6])) == [(i, bytes([i])) for i in (5, 2, 6)]


def test_a_sync_read_may_end_at_the_first_servo_missing(servos):
    asked = [Register.ID, 1, 5, 9, 6]
    assert answers(do(servos, ALL, SYNC_READ, asked, stall_behind_missing=True)) == [(5, b"\x05")]


def test_a_sync_write_is_taken_by_each_servo_and_answered_by_none(servos):
    goals = {i: goal_block(2000 + i, 700) for i in (1, 4)}
    (effect,) = do(servos, ALL, SYNC_WRITE, sync_write_parameters(GOAL_ADDRESS, goals))
    assert (effect.answers, effect.address, effect.written) == ([], GOAL_ADDRESS, goals)
    assert [servos[i - 1].value(Register.GOAL_POSITION) for i in (1, 2, 4)] == [2001, 0, 2004]


def test_a_write_is_acknowledged_unless_broadcast_or_switched_off(servos):
    assert answers(do(servos, 2, WRITE, [Register.TORQUE_LIMIT, 100, 0])) == [(2, b"")]
    assert answers(do(servos, ALL, WRITE, [Register.TORQUE_ENABLE, 0])) == []
    assert answers(do(servos, 2, WRITE, [Register.RESPONSE_LEVEL, 0])) == []
    assert answers(do(servos, 2, READ, [Register.ID, 1])) == [(2, b"\x02")]


def test_a_kept_write_acts_when_it_is_called_for_and_once(servos):
    do(servos, 2, REG_WRITE, [Register.TORQUE_LIMIT, 100, 0])
    do(servos, 3, REG_WRITE, [Register.TORQUE_LIMIT, 200, 0])
    assert servos[1].value(Register.TORQUE_LIMIT) == 1000
    effects = do(servos, ALL, ACTION)
    assert [effect.written for effect in effects if effect.written] == [{2: bytes([100, 0])}, {3: bytes([200, 0])}]
    assert [servo.value(Register.TORQUE_LIMIT) for servo in servos[1:3]] == [100, 200]
    assert not any(effect.written for effect in do(servos, ALL, ACTION))


def test_a_kept_write_does_not_outlive_a_reboot(servos):
    do(servos, 2, REG_WRITE, [Register.TORQUE_LIMIT, 100, 0])
    do(servos, 2, REBOOT)
    do(servos, 2, ACTION)
    assert servos[1].value(Register.TORQUE_LIMIT) == 1000


def test_a_restore_brings_back_what_was_backed_up_for_good_and_keeps_the_id(servos):
    servos[0].write(Register.P_GAIN, bytes([20]))
    do(servos, 1, BACKUP)
    servos[0].write(Register.P_GAIN, bytes([5]))
    servos[0].write(Register.ID, bytes([9]))
    do(servos, 9, RESTORE)
    do(servos, 9, REBOOT)
    assert (servos[0].servo_id, servos[0].value(Register.P_GAIN)) == (9, 20)


@pytest.mark.parametrize(("code", "parameters"), [(CALIBRATE, []), (WRITE, [Register.TORQUE_ENABLE, 128])])
def test_the_present_position_is_made_the_middle_for_good(servos, code, parameters):
    servos[5].write(Register.TORQUE_ENABLE, bytes([1]))
    assert servos[5].present_ticks != 2048
    do(servos, 6, code, parameters)
    assert servos[5].present_ticks == 2048
    assert servos[5].value(Register.TORQUE_ENABLE) == 1
    do(servos, 6, REBOOT)
    assert servos[5].present_ticks == 2048


def test_a_middle_out_of_reach_comes_as_near_as_the_offset_goes(servos):
    servos[0].plant.position_ticks = 0.0
    do(servos, 1, CALIBRATE)
    assert servos[0].present_ticks == 2047
    assert servos[0].value(Register.HOMING_OFFSET) == -2047


def test_a_reset_of_turns_is_acknowledged_and_changes_nothing(servos):
    servos[0].write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, 1234))
    assert answers(do(servos, 1, RESET)) == [(1, b"")]
    assert servos[0].value(Register.GOAL_POSITION) == 1234


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


@given(st.integers(0, 0xFD), st.integers(0, 63), st.binary(max_size=40))
def test_a_status_packet_is_read_by_the_drivers_own_parser(servo_id, error, data):
    frames = parse_status_frames(status_packet(servo_id, error, data), [servo_id], len(data))
    assert not frames or (frames[servo_id].error, frames[servo_id].data) == (error, data)


def test_an_instruction_cut_off_does_not_swallow_a_later_one():
    parser = InstructionParser()
    assert parser.feed(packet(1, WRITE, bytes(60))[:10], 0.0) == []
    assert parser.feed(packet(2, PING), 0.1) == [Instruction(2, PING, b"")]
