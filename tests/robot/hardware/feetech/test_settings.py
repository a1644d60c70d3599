from __future__ import annotations

import math

import pytest

from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from robot.hardware.feetech.settings import EPROM, SETTINGS, SETTINGS_BYTES, parse_settings
from robot.hardware.feetech.survey import read_settings
from tests.helpers.arm_rig import run


def test_the_settings_are_what_single_reads_of_the_registers_tell(bus: Bus) -> None:
    settings = run(read_settings(bus, 3))
    assert {register: settings[register] for register in SETTINGS} == {
        register: bus.read(3, register) for register in SETTINGS
    }


def test_a_negative_offset_keeps_its_sign(bus: Bus) -> None:
    bus.write(3, Register.HOMING_OFFSET, -1234)
    assert run(read_settings(bus, 3))[Register.HOMING_OFFSET] == -1234


def test_quantities_have_units() -> None:
    data = bytearray(SETTINGS_BYTES)
    data[Register.MAX_TORQUE : Register.MAX_TORQUE + 2] = (500).to_bytes(2, "little")
    data[Register.OVERLOAD_TORQUE], data[Register.PROTECTION_TIME] = 25, 200
    data[Register.PROTECTION_CURRENT] = 250
    settings = parse_settings(bytes(data))
    assert settings.max_torque == pytest.approx(0.5)
    assert settings.overload_torque == pytest.approx(0.25)
    assert settings.protection_time_s == pytest.approx(2.0)
    assert settings.protection_current_a == pytest.approx(1.625)


def test_a_protection_without_a_threshold_protects_from_nothing() -> None:
    settings = parse_settings(bytes(SETTINGS_BYTES))
    assert settings.overload_torque == settings.protection_time_s == settings.protection_current_a == math.inf


def test_identity_is_no_setting_that_could_be_written() -> None:
    assert set(SETTINGS) - set(EPROM) == {Register.FIRMWARE_MAJOR, Register.FIRMWARE_MINOR, Register.MODEL_NUMBER}


def test_a_block_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="40 bytes, not 39"):
        parse_settings(bytes(SETTINGS_BYTES - 1))
