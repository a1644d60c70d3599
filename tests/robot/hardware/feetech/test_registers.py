from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    EPROM,
    LAYOUT,
    SETTINGS,
    SETTINGS_BLOCK,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Register,
    decode,
    parse_telemetry,
)
from robot.hardware.interface import status_names
from robot.hardware.servos.bus import read_registers
from tests.helpers.arm_rig import run


@pytest.mark.parametrize(
    ("register", "data", "value"),
    [
        (Register.HOMING_OFFSET, b"\x10\x08", -16),
        (Register.PRESENT_LOAD, b"\x2c\x04", -44),
        (Register.PRESENT_POSITION, b"\x01\x80", -1),
        (Register.GOAL_VELOCITY, b"\xe8\x03", 1000),
    ],
)
def test_the_sign_stands_in_each_registers_own_bit(register, data, value):
    assert decode(register, data) == value


def test_a_telemetry_block_of_another_length_is_refused():
    with pytest.raises(ValueError, match="15 bytes, not 14"):
        parse_telemetry(bytes(14))


@given(st.binary(min_size=TELEMETRY_BYTES, max_size=TELEMETRY_BYTES))
def test_telemetry_is_read_as_its_registers_are(block):
    parsed = parse_telemetry(block)
    values = {
        Register.PRESENT_POSITION: parsed.position_ticks,
        Register.PRESENT_VELOCITY: parsed.velocity_ticks_s,
        Register.PRESENT_VELOCITY: parsed.velocity_ticks_s,
        Register.PRESENT_LOAD: round(1000.0 * parsed.load),
        Register.PRESENT_VOLTAGE: round(10.0 * parsed.voltage_v),
        Register.STATUS: parsed.status,
        Register.PRESENT_TEMPERATURE: parsed.temperature_c,
    }
    for register, value in values.items():
        at = register - TELEMETRY_ADDRESS
        assert value == decode(register, block[at : at + LAYOUT[register].size])
    current = Register.PRESENT_CURRENT - TELEMETRY_ADDRESS
    assert parsed.current_a == decode(Register.PRESENT_CURRENT, block[current : current + 2]) * AMPERE_PER_UNIT
    assert AMPERE_PER_UNIT == 0.0065


@given(st.integers(0, 255))
def test_every_documented_status_bit_is_named_and_no_other(status):
    assert len(status_names(status)) == (status & 0b111111).bit_count()


def test_the_settings_are_the_registers_below_the_ram_and_identity_cannot_be_written(bus):
    bus.write(3, Register.HOMING_OFFSET, -1234)
    assert run(read_registers(bus, 3, SETTINGS_BLOCK)) == {register: bus.read(3, register) for register in SETTINGS}
    assert set(SETTINGS) - set(EPROM) == {Register.FIRMWARE_MAJOR, Register.FIRMWARE_MINOR, Register.MODEL_NUMBER}
