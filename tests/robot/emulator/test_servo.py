from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.plant import Plant
from robot.emulator.servo import Servo
from robot.hardware.feetech.registers import (
    LAYOUT,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    decode,
    encode,
    goal_block,
    parse_telemetry,
)
from robot.hardware.interface import StatusFlag


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


def test_a_power_cut_clears_what_is_not_eprom():
    servo = servo_at()
    put(servo, Register.LOCK, 0)
    servo.write(Register.TORQUE_ENABLE, bytes([1]) + goal_block(2048, 1000))
    servo.power_up()
    run(servo, 0.5)
    assert get(servo, Register.TORQUE_ENABLE) == get(servo, Register.GOAL_POSITION) == 0
    assert servo.present_ticks == 2048


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


def holding_servo(**registers):
    servo = servo_at()
    put(servo, Register.GOAL_POSITION, 2048)
    for name, value in registers.items():
        put(servo, Register[name], value)
    put(servo, Register.TORQUE_ENABLE, 1)
    return servo


def test_a_joint_that_is_stuck_overloads_and_goes_weak_until_torque_is_off():
    servo = holding_servo()
    servo.plant.block(2060)
    put(servo, Register.GOAL_POSITION, 2600)
    run(servo, 1.9)
    assert servo.error == 0
    assert get(servo, Register.PRESENT_LOAD) == 1000
    run(servo, 0.3)
    assert servo.error == get(servo, Register.STATUS) == StatusFlag.OVERLOAD
    assert get(servo, Register.PRESENT_LOAD) == 200
    servo.plant.block(None)
    put(servo, Register.TORQUE_ENABLE, 0)
    put(servo, Register.GOAL_POSITION, servo.present_ticks)
    put(servo, Register.TORQUE_ENABLE, 1)
    run(servo, 0.1)
    assert servo.error == 0


def test_below_its_overload_torque_a_stuck_joint_does_not_overload():
    servo = holding_servo(TORQUE_LIMIT=500)
    servo.plant.block(2060)
    put(servo, Register.GOAL_POSITION, 2600)
    run(servo, 5.0)
    assert servo.error == 0


def test_a_stuck_joint_draws_more_than_its_protection_current_and_is_cut_off():
    servo = holding_servo(PROTECTION_CURRENT=100, OVERLOAD_TORQUE=200)
    servo.plant.block(2060)
    put(servo, Register.GOAL_POSITION, 2600)
    run(servo, 2.5)
    assert servo.error == StatusFlag.CURRENT
    assert get(servo, Register.PRESENT_CURRENT) == 0


def test_a_hot_servo_tells_it_lets_go_and_holds_again_when_cool():
    servo = holding_servo()
    servo.motor.temperature_c = 75.0
    run(servo, 0.05)
    assert servo.error == StatusFlag.TEMPERATURE
    assert get(servo, Register.PRESENT_TEMPERATURE) == 75
    put(servo, Register.GOAL_POSITION, 2200)
    run(servo, 0.3)
    assert servo.present_ticks == 2048
    servo.motor.temperature_c = 50.0
    run(servo, 1.0)
    assert servo.present_ticks == 2200


def test_a_wrong_supply_is_told_and_does_not_stop_the_motion():
    servo = holding_servo()
    servo.voltage_v = 12.0
    put(servo, Register.GOAL_POSITION, 2200)
    run(servo, 1.0)
    assert (servo.error, servo.present_ticks) == (StatusFlag.VOLTAGE, 2200)
    assert get(servo, Register.PRESENT_VOLTAGE) == 120


def test_a_servo_may_power_up_holding_where_it_is():
    servo = servo_at(2500.0, offset=-100)
    servo.powers_up_holding = True
    servo.power_up()
    run(servo, 1.0)
    assert get(servo, Register.TORQUE_ENABLE) == 1
    assert servo.present_ticks == get(servo, Register.GOAL_POSITION) == 2500


@pytest.mark.parametrize("value", [2, 3, 255])
def test_only_one_is_torque_on(value):
    servo = servo_at()
    put(servo, Register.TORQUE_ENABLE, value)
    run(servo, 0.5)
    assert servo.present_ticks == 2048
