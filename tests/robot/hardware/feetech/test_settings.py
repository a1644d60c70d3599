from __future__ import annotations

import math

import pytest

from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from robot.hardware.feetech.settings import EPROM, SETTINGS, SETTINGS_BLOCK, ServoSettings
from robot.hardware.servos.bus import read_registers
from tests.helpers.arm_rig import run


def test_the_settings_are_what_single_reads_of_the_registers_tell(bus: Bus) -> None:
    settings = run(read_registers(bus, 3, SETTINGS_BLOCK))
    assert {register: settings[register] for register in SETTINGS} == {
        register: bus.read(3, register) for register in SETTINGS
    }


def test_a_negative_offset_keeps_its_sign(bus: Bus) -> None:
    bus.write(3, Register.HOMING_OFFSET, -1234)
    assert run(read_registers(bus, 3, SETTINGS_BLOCK))[Register.HOMING_OFFSET] == -1234


UNSET = ServoSettings(dict.fromkeys(SETTINGS, 0))


def test_quantities_have_units() -> None:
    values = {
        Register.MAX_TORQUE: 500,
        Register.OVERLOAD_TORQUE: 25,
        Register.PROTECTION_TIME: 200,
        Register.PROTECTION_CURRENT: 250,
    }
    settings = ServoSettings({**UNSET.values, **values})
    assert settings.max_torque == pytest.approx(0.5)
    assert settings.overload_torque == pytest.approx(0.25)
    assert settings.protection_time_s == pytest.approx(2.0)
    assert settings.protection_current_a == pytest.approx(1.625)


def test_a_protection_without_a_threshold_protects_from_nothing() -> None:
    assert UNSET.overload_torque == UNSET.protection_time_s == UNSET.protection_current_a == math.inf


def test_identity_is_no_setting_that_could_be_written() -> None:
    assert set(SETTINGS) - set(EPROM) == {Register.FIRMWARE_MAJOR, Register.FIRMWARE_MINOR, Register.MODEL_NUMBER}
