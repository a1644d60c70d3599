from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import Calibration
from robot.commissioning.calibrate import MIDDLE_TICK, Sweep, calibrate, differences, write_to_servos
from robot.commissioning.scan import scan
from robot.errors import CalibrationError
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end
from tests.helpers.robots import SO101_SERVOS, nominal_calibration
from tests.helpers.server import read_write_log

IDS = tuple(spec.servo_id for spec in SO101_SERVOS)
NO_OFFSETS = dict.fromkeys(IDS, 0)


def swept(middle, lowest, highest):
    """A sweep of every joint about its middle, as a servo reports it: within one turn."""
    sweep = Sweep(dict.fromkeys(IDS, middle))
    for stop in (lowest, highest):
        step = 100 if stop > middle else -100
        for ticks in [*range(middle, stop, step), stop]:
            sweep.add(dict.fromkeys(IDS, ticks % 4096))
        sweep.add(dict.fromkeys(IDS, middle % 4096))
    return sweep


def test_a_sweep_remembers_how_far_each_joint_was_moved():
    sweep = swept(2000, 900, 3100)
    assert (sweep.lowest[3], sweep.present[3], sweep.highest[3]) == (900, 2000, 3100)


@given(st.integers(0, 4095), st.integers(-1500, -300), st.integers(300, 1500), st.integers(-2047, 2047))
def test_wherever_the_encoder_stands_the_new_offset_puts_the_middle_in_the_middle(middle, down, up, offset):
    sweep = swept(middle, middle + down, middle + up)
    calibration = calibrate(SO101_SERVOS, sweep, dict.fromkeys(IDS, offset), recentre=True)
    for joint in calibration.joints:
        moved_frame = (middle + offset - joint.homing_offset) % 4096
        assert abs(moved_frame - MIDDLE_TICK) <= 1
        assert abs(joint.homing_offset) <= 2047
        if joint.joint != "wrist_roll":
            assert (joint.range_min, joint.range_max) == (moved_frame + down, moved_frame + up)


def test_without_new_offsets_the_ranges_are_what_the_servos_report():
    calibration = calibrate(SO101_SERVOS, swept(2050, 900, 3100), dict.fromkeys(IDS, 37), recentre=False)
    elbow, roll = calibration.joints[2], calibration.joints[4]
    assert (elbow.homing_offset, elbow.range_min, elbow.range_max) == (37, 900, 3100)
    assert (roll.range_min, roll.range_max) == (0, 4095)


def test_a_range_across_the_seam_is_refused_and_new_offsets_are_named_as_the_remedy():
    sweep = swept(300, 300 - 1000, 300 + 1000)
    with pytest.raises(CalibrationError, match=r"-700 to 1300 ticks crosses the seam .*--write-servos"):
        calibrate(SO101_SERVOS, sweep, NO_OFFSETS, recentre=False)
    calibrate(SO101_SERVOS, sweep, NO_OFFSETS, recentre=True)


def test_a_joint_that_was_not_moved_is_named():
    with pytest.raises(CalibrationError, match="shoulder_pan: was moved by 30 ticks"):
        calibrate(SO101_SERVOS, swept(2047, 2030, 2060), NO_OFFSETS, recentre=False)


def test_a_free_joint_off_the_formats_middle_needs_a_new_offset():
    sweep = swept(2047, 900, 3100)
    sweep.middle[5] = 2500
    with pytest.raises(CalibrationError, match="wrist_roll: its middle is tick 2500"):
        calibrate(SO101_SERVOS, sweep, NO_OFFSETS, recentre=False)


def test_servos_that_hold_the_calibration_differ_in_nothing(bus):
    assert differences(nominal_calibration(), scan(bus, IDS).servos) == []


def test_only_what_differs_is_written_and_it_outlives_a_power_cut(start_emulator, write_log):
    emulator = start_emulator("--write-log", str(write_log))
    nominal = nominal_calibration()
    elbow = replace(nominal.joints[2], range_min=950, homing_offset=-12)
    wanted = Calibration((*nominal.joints[:2], elbow, *nominal.joints[3:]))
    bus = emulator.open_bus()
    run_to_end(write_to_servos(bus, differences(wanted, scan(bus, IDS).servos)), emulator.run)
    emulator.command(power_cycle=[3])
    assert differences(wanted, scan(bus, IDS).servos) == []
    written = [(entry["address"], *entry["data"]) for entry in read_write_log(write_log) if entry["data"]]
    assert set(written) <= {(Register.LOCK, "3"), (Register.HOMING_OFFSET, "3"), (Register.MIN_ANGLE_LIMIT, "3")} | {
        (Register.TORQUE_ENABLE, "3")
    }
    assert bus.read(3, Register.LOCK) == 1
    bus.close()
