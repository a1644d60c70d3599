from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.servo import (
    FACTORY_EPROM,
    MEMORY_BYTES,
    OVERCURRENT_TIME_S,
    Measured,
    Memory,
    Protection,
    Thresholds,
)
from robot.hardware.feetech.registers import LAYOUT, Area, Register, decode, encode
from robot.hardware.interface import StatusFlag


def memory():
    return Memory({**FACTORY_EPROM, Register.ID: 4})


def put(memory, register, value):
    memory.write(register, encode(register, value))


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


def test_the_torque_limit_comes_up_as_the_eprom_says():
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


def test_a_servo_that_is_well_complains_of_nothing_and_gives_all():
    protection = after(10.0, WELL)
    assert protection.status == 0
    assert protection.duty_left_permille(LIMITS) == 1000.0


def test_an_overload_is_told_after_its_time_and_leaves_a_fifth_of_the_torque():
    assert after(1.9, STUCK).status == 0
    protection = after(2.1, STUCK)
    assert protection.status == StatusFlag.OVERLOAD
    assert protection.duty_left_permille(LIMITS) == 200.0


def test_a_pause_in_the_load_starts_the_timer_anew():
    protection = after(1.5, STUCK)
    after(0.02, WELL, protection)
    assert after(1.5, STUCK, protection).status == 0


def test_too_much_current_is_told_after_its_time_and_leaves_nothing():
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
def test_a_wrong_supply_is_told_as_long_as_it_lasts_and_takes_no_torque(voltage_v):
    protection = after(0.01, replace(WELL, voltage_v=voltage_v))
    assert protection.status == StatusFlag.VOLTAGE
    assert protection.duty_left_permille(LIMITS) == 1000.0
    assert after(0.01, WELL, protection).status == 0


def test_a_hot_servo_gives_nothing_until_it_has_cooled():
    protection = after(0.01, replace(WELL, temperature_c=71.0))
    assert protection.status == StatusFlag.TEMPERATURE
    assert protection.duty_left_permille(LIMITS) == 0.0
    assert after(0.01, WELL, protection).duty_left_permille(LIMITS) == 1000.0


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
