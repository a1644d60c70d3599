from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.plant import Plant
from robot.emulator.servo import (
    FACTORY_EPROM,
    MEMORY_BYTES,
    OVERCURRENT_TIME_S,
    Measured,
    Memory,
    Protection,
    Servo,
    Thresholds,
)
from robot.hardware.feetech.registers import (
    LAYOUT,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Area,
    Register,
    decode,
    encode,
    goal_block,
    parse_telemetry,
)
from robot.hardware.interface import StatusFlag


def servo_at(ticks=2048.0, limits=(800, 3300), offset=0):
    eprom = {
        Register.ID: 4,
        Register.MIN_ANGLE_LIMIT: limits[0],
        Register.MAX_ANGLE_LIMIT: limits[1],
        Register.HOMING_OFFSET: offset,
    }
    return Servo(Plant(ticks + offset, 0.0, 4095.0), eprom)


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
    assert get(servo, Register.PRESENT_POSITION) == (2000 + offset) % 4096


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
    assert servo.value(Register.MOVING)
    assert moving.velocity_ticks_s == pytest.approx(800, abs=5)
    assert moving.load > 0
    assert servo.value(Register.GOAL_POSITION_ECHO) == 3000
    run(servo, 2.0)
    still = parse_telemetry(servo.read(TELEMETRY_ADDRESS, TELEMETRY_BYTES))
    assert (servo.value(Register.MOVING), still.position_ticks, still.velocity_ticks_s) == (0, 3000, 0)


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


def test_a_hot_servo_reports_it_lets_go_and_holds_again_when_cool():
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


def memory():
    return Memory({**FACTORY_EPROM, Register.ID: 4})


def test_memory_beyond_the_end_reads_as_zero():
    assert memory().read(MEMORY_BYTES - 1, 10) == bytes(10)
    assert len(memory().read(0, 255)) == 255


@given(st.lists(st.tuples(st.integers(0, 90), st.binary(min_size=1, max_size=20)), max_size=10))
def test_a_value_is_always_that_of_the_bytes(writes):
    written = memory()
    for address, data in writes:
        written.write(address, data)
        for register in Register:
            assert written.value(register) == decode(register, written.read(register, LAYOUT[register].size))


@given(st.integers(0, 255), st.binary(max_size=100))
def test_no_write_changes_what_is_read_only(address, data):
    written = memory()
    read_only = [register for register in Register if LAYOUT[register].area is Area.READ_ONLY]
    before = {register: written.value(register) for register in read_only}
    written.write(address, data)
    assert {register: written.value(register) for register in read_only} == before


@pytest.mark.parametrize(("lock", "kept"), [(1, 32), (0, 16)])
def test_eprom_outlives_a_power_cut_only_when_written_unlocked(lock, kept):
    written = memory()
    put(written, Register.LOCK, lock)
    put(written, Register.P_GAIN, 16)
    assert written.value(Register.P_GAIN) == 16
    written.power_up()
    assert written.value(Register.P_GAIN) == kept


def test_the_torque_limit_after_power_up_is_that_of_the_eprom():
    written = memory()
    put(written, Register.LOCK, 0)
    put(written, Register.MAX_TORQUE, 500)
    put(written, Register.TORQUE_LIMIT, 100)
    written.power_up()
    assert written.value(Register.TORQUE_LIMIT) == 500


def test_a_measured_value_too_large_shows_as_the_largest():
    shown = memory()
    shown.show(Register.PRESENT_LOAD, -5000)
    assert shown.value(Register.PRESENT_LOAD) == -1023
    shown.show(Register.PRESENT_TEMPERATURE, 300)
    assert shown.value(Register.PRESENT_TEMPERATURE) == 255


def test_without_a_backup_a_restore_brings_back_what_was_there_at_first_but_for_the_id():
    written = memory()
    put(written, Register.LOCK, 0)
    put(written, Register.P_GAIN, 16)
    put(written, Register.ID, 9)
    written.restore()
    assert (written.value(Register.P_GAIN), written.value(Register.ID)) == (32, 9)


LIMITS = Thresholds(
    voltage_v=(4.0, 8.0),
    temperature_c=70.0,
    overload_permille=800.0,
    overload_s=2.0,
    protective_permille=200.0,
    current_a=3.25,
    unloading=StatusFlag.TEMPERATURE | StatusFlag.CURRENT | StatusFlag.OVERLOAD,
)
WELL = Measured(duty_permille=100.0, current_a=0.2, temperature_c=30.0, voltage_v=5.0)
STUCK = replace(WELL, duty_permille=-900.0)
SHORTED = replace(WELL, current_a=-3.5)


def after(duration_s, measured, protection=None):
    protection = protection or Protection()
    for _ in range(round(duration_s / 0.01)):
        protection.step(0.01, measured, LIMITS)
    return protection


def test_a_pause_in_the_load_starts_the_timer_anew():
    protection = after(1.5, STUCK)
    after(0.02, WELL, protection)
    assert after(1.5, STUCK, protection).status == 0


def test_too_much_current_is_flagged_after_its_time_and_leaves_nothing():
    assert after(OVERCURRENT_TIME_S - 0.1, SHORTED).status == 0
    protection = after(OVERCURRENT_TIME_S + 0.1, SHORTED)
    assert protection.status == StatusFlag.CURRENT
    assert protection.duty_left_permille(LIMITS) == 0.0


@pytest.mark.parametrize("trouble", [STUCK, SHORTED])
def test_what_is_latched_outlives_its_cause_until_torque_is_off(trouble):
    protection = after(3.0, trouble)
    assert after(1.0, WELL, protection).status != 0
    protection.torque_off()
    assert after(0.01, WELL, protection).status == 0


def test_a_servo_may_latch_until_its_power_is_cut():
    protection = after(3.0, STUCK)
    protection.latches = True
    protection.torque_off()
    assert after(1.0, WELL, protection).status == StatusFlag.OVERLOAD
    protection.power_up()
    assert after(1.0, WELL, protection).status == 0


@pytest.mark.parametrize("voltage_v", [3.9, 12.0])
def test_a_wrong_supply_is_reported_as_long_as_it_lasts_and_takes_no_torque(voltage_v):
    protection = after(0.01, replace(WELL, voltage_v=voltage_v))
    assert protection.status == StatusFlag.VOLTAGE
    assert protection.duty_left_permille(LIMITS) == 1000.0
    assert after(0.01, WELL, protection).status == 0


def test_a_complaint_that_does_not_unload_takes_no_torque():
    hot = after(0.01, replace(WELL, temperature_c=71.0))
    assert hot.duty_left_permille(replace(LIMITS, unloading=StatusFlag(0))) == 1000.0


def test_a_forced_complaint_outlives_everything():
    protection = Protection()
    protection.forced = StatusFlag.ENCODER
    protection.power_up()
    assert after(0.1, WELL, protection).status == StatusFlag.ENCODER
    protection.torque_off()
    assert after(0.1, WELL, protection).status == StatusFlag.ENCODER
