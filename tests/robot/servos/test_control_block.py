from __future__ import annotations

import pytest

from robot.servos.bus import Bus
from robot.servos.control_block import CONTROL_ADDRESS, CONTROL_BYTES, Control, parse_control
from robot.servos.registers import GOAL_ADDRESS, Register, goal_block


def test_the_block_tells_what_the_servo_was_told(bus: Bus) -> None:
    bus.sync_write(GOAL_ADDRESS, {2: goal_block(1999, 100, 33)})
    bus.write(2, Register.TORQUE_LIMIT, 432)
    bus.write(2, Register.TORQUE_ENABLE, 1)
    frame = bus.sync_read((2,), CONTROL_ADDRESS, CONTROL_BYTES)[2]
    assert parse_control(frame.data) == Control(True, 33, 1999, 432)


def test_a_block_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="16 bytes, not 3"):
        parse_control(b"abc")
