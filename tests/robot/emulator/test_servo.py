from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.plant import Plant
from robot.emulator.servo import MEMORY_BYTES, Servo
from robot.registers import (
    LAYOUT,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    decode,
    encode,
    goal_block,
    parse_telemetry,
)


def servo_at(ticks=2048.0, limits=(800, 3300), offset=0):
    return Servo(4, Plant(ticks + offset, 0.0, 4095.0), limits, offset)


def put(servo, register, value):
    servo.write(register, encode(register, value))


def get(servo, register):
    return decode(register, servo.read(register, LAYOUT[register].size))


def run(servo, duration_s):
    for _ in range(round(duration_s / 0.01)):
        servo.step(0.01)


def test_at_power_up_torque_is_off_and_the_goal_stale():
    servo = servo_at()
    assert get(servo, Register.TORQUE_ENABLE) == 0
    assert get(servo, Register.GOAL_POSITION) == 0
    assert get(servo, Register.LOCK) == 1
    assert get(servo, Register.TORQUE_LIMIT) == get(servo, Register.MAX_TORQUE) == 1000
    assert (get(servo, Register.MODEL_NUMBER), get(servo, Register.ID)) == (777, 4)


def test_torque_switched_on_blindly_makes_the_arm_jump():
    servo = servo_at()
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 0.2)
    assert servo.present_ticks < 2048 - 300


def test_torque_switched_on_at_the_present_position_holds():
    servo = servo_at()
    put(servo, Register.GOAL_POSITION, servo.present_ticks)
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 0.5)
    assert servo.present_ticks == 2048


def test_a_goal_is_followed_only_with_torque_on():
    servo = servo_at()
    servo.write(Register.ACCELERATION, goal_block(2200, 1000))
    run(servo, 0.5)
    assert servo.present_ticks == 2048
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 0.5)
    assert servo.present_ticks == 2200
    put(servo, Register.TORQUE_LIMIT, 0)
    put(servo, Register.GOAL_POSITION, 2400)
    run(servo, 0.5)
    assert servo.present_ticks == 2200


@pytest.mark.parametrize(("goal", "reached"), [(100, 800), (4000, 3300)])
def test_a_goal_beyond_the_angle_limits_ends_at_the_limit(goal, reached):
    servo = servo_at()
    put(servo, Register.GOAL_POSITION, goal)
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 2.0)
    assert servo.present_ticks == reached
    assert get(servo, Register.GOAL_POSITION) == goal
    assert get(servo, Register.GOAL_POSITION_ECHO) == reached


@given(st.integers(-2047, 2047))
def test_present_position_is_the_encoder_less_the_homing_offset(offset):
    servo = servo_at(2000.0, offset=offset)
    assert get(servo, Register.PRESENT_POSITION) == 2000
    put(servo, Register.HOMING_OFFSET, 0)
    assert get(servo, Register.PRESENT_POSITION) == 2000 + offset


@pytest.mark.parametrize(("lock", "kept"), [(1, 32), (0, 16)])
def test_eprom_outlives_a_power_cut_only_when_written_unlocked(lock, kept):
    servo = servo_at()
    put(servo, Register.LOCK, lock)
    put(servo, Register.P_GAIN, 16)
    assert get(servo, Register.P_GAIN) == 16
    servo.power_up()
    assert get(servo, Register.P_GAIN) == kept


def test_a_power_cut_clears_what_is_not_eprom():
    servo = servo_at()
    put(servo, Register.LOCK, 0)
    servo.write(Register.TORQUE_ENABLE, bytes([1]) + goal_block(2048, 1000))
    servo.power_up()
    run(servo, 0.5)
    assert get(servo, Register.TORQUE_ENABLE) == get(servo, Register.GOAL_POSITION) == 0
    assert servo.present_ticks == 2048


@given(st.integers(0, 255), st.binary(max_size=100))
def test_no_write_changes_what_is_read_only(address, data):
    servo = servo_at()
    constant = (Register.MODEL_NUMBER, Register.PRESENT_VOLTAGE, Register.PRESENT_TEMPERATURE, Register.STATUS)
    before = {register: get(servo, register) for register in constant}
    servo.write(address, data)
    assert {r: get(servo, r) for r in before} == before
    assert len(servo.read(0, 255)) == 255


def test_memory_beyond_the_end_reads_as_zero():
    assert servo_at().read(MEMORY_BYTES - 1, 10) == bytes(10)


def test_telemetry_shows_the_motion():
    servo = servo_at()
    servo.write(Register.ACCELERATION, goal_block(3000, 800))
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 0.5)
    moving = parse_telemetry(servo.read(TELEMETRY_ADDRESS, TELEMETRY_BYTES))
    assert moving.moving
    assert moving.velocity_ticks_s == pytest.approx(800, abs=5)
    assert moving.load_permille > 0
    assert moving.goal_ticks_echo == 3000
    run(servo, 2.0)
    still = parse_telemetry(servo.read(TELEMETRY_ADDRESS, TELEMETRY_BYTES))
    assert (still.moving, still.position_ticks, still.velocity_ticks_s) == (False, 3000, 0)


def test_a_position_beyond_what_its_register_holds_shows_as_the_largest():
    servo = servo_at()
    put(servo, Register.MIN_ANGLE_LIMIT, 40_000)
    put(servo, Register.MAX_ANGLE_LIMIT, 50_000)
    assert get(servo, Register.GOAL_POSITION_ECHO) == 32_767
