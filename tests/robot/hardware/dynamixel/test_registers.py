from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.hardware.dynamixel.registers import (
    LAYOUT,
    MODELS,
    MOTION_BYTES,
    TELEMETRY_BYTES,
    TICKS_S_PER_VELOCITY_UNIT,
    Motion,
    Register,
    decode,
    encode,
    parse_climate,
    parse_motion,
    status_of,
    value_range,
)
from robot.hardware.interface import StatusFlag


@given(st.sampled_from(Register), st.data())
def test_every_value_of_a_register_is_read_as_it_was_written(register: Register, data: st.DataObject) -> None:
    lowest, highest = value_range(register)
    value = data.draw(st.integers(lowest, highest))
    written = encode(register, value)
    assert len(written) == LAYOUT[register].size
    assert decode(register, written) == value


def test_registers_do_not_overlap() -> None:
    taken = [address for register, layout in LAYOUT.items() for address in range(register, register + layout.size)]
    assert len(taken) == len(set(taken))
    assert set(LAYOUT) == set(Register)


def test_a_value_beyond_its_register_is_refused() -> None:
    with pytest.raises(ValueError, match="BUS_WATCHDOG holds -128 to 127, not 128"):
        encode(Register.BUS_WATCHDOG, 128)
    with pytest.raises(ValueError, match="has 4 bytes, not 2"):
        decode(Register.GOAL_POSITION, b"ab")


def test_negative_positions_are_in_twos_complement() -> None:
    assert encode(Register.GOAL_POSITION, -1) == b"\xff\xff\xff\xff"
    assert decode(Register.PRESENT_POSITION, b"\x00\xf0\xff\xff") == -4096


def test_models_have_the_numbers_that_they_report() -> None:
    assert {name: model.number for name, model in MODELS.items()} == {"xl430-w250": 1060, "xl330-m288": 1200}


BLOCK = struct.pack("<hhiiiiHB", -200, 350, -12, 5000, 0, 0, 118, 41)


def test_a_block_of_measurements_is_parsed() -> None:
    assert len(BLOCK) == TELEMETRY_BYTES
    assert parse_motion(BLOCK) == parse_motion(BLOCK[:MOTION_BYTES]) == Motion(-200, 350, -12, 5000)
    climate = parse_climate(BLOCK)
    assert (climate.voltage_v, climate.temperature_c) == (pytest.approx(11.8), 41)
    assert parse_climate(BLOCK[:MOTION_BYTES]) is None


def test_a_block_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="12 or 23 bytes, not 13"):
        parse_motion(BLOCK[:13])


def test_a_turn_a_second_is_60_rev_per_min() -> None:
    assert pytest.approx(0.229 * 4096) == 60.0 * TICKS_S_PER_VELOCITY_UNIT


@pytest.mark.parametrize(
    ("bits", "status"),
    [
        (0x00, StatusFlag(0)),
        (0x01, StatusFlag.VOLTAGE),
        (0x04, StatusFlag.TEMPERATURE),
        (0x08, StatusFlag.ENCODER),
        (0x10, StatusFlag.CURRENT),
        (0x20, StatusFlag.OVERLOAD),
        (0x24, StatusFlag.TEMPERATURE | StatusFlag.OVERLOAD),
        (0xC2, StatusFlag(0)),
    ],
)
def test_hardware_errors_are_the_controllers_status_flags(bits: int, status: StatusFlag) -> None:
    assert status_of(bits) == status
