from __future__ import annotations

import pytest

from robot.hardware.dynamixel.registers import (
    MODELS,
    TICKS_S_PER_VELOCITY_UNIT,
    Register,
    decode,
    encode,
    status_of,
)
from robot.hardware.interface import StatusFlag


def test_negative_positions_are_in_twos_complement() -> None:
    assert encode(Register.GOAL_POSITION, -1) == b"\xff\xff\xff\xff"
    assert decode(Register.PRESENT_POSITION, b"\x00\xf0\xff\xff") == -4096


def test_models_have_the_numbers_that_they_report() -> None:
    assert {name: model.number for name, model in MODELS.items()} == {"xl430-w250": 1060, "xl330-m288": 1200}


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
