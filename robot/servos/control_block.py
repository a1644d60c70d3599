"""What a servo was told: its registers 40 to 55, read back in one piece."""

from __future__ import annotations

from dataclasses import dataclass

from robot.servos.registers import LAYOUT, Register, decode

CONTROL_ADDRESS = Register.TORQUE_ENABLE
CONTROL_BYTES = Register.LOCK + 1 - Register.TORQUE_ENABLE


@dataclass(frozen=True)
class Control:
    """What a servo was told.

    Attributes:
        torque_on: whether its motor is driven.
        acceleration: register ACCELERATION, 0 after power-up.
        goal_ticks: register GOAL_POSITION.
        torque_limit_permille: register TORQUE_LIMIT, MAX_TORQUE after power-up.
    """

    torque_on: bool
    acceleration: int
    goal_ticks: int
    torque_limit_permille: int


def parse_control(data: bytes) -> Control:
    """Read the control block, ``CONTROL_BYTES`` from ``CONTROL_ADDRESS`` on.

    Raises:
        ValueError: ``data`` has another length.
    """
    if len(data) != CONTROL_BYTES:
        raise ValueError(f"the control block has {CONTROL_BYTES} bytes, not {len(data)}")

    def value(register: Register) -> int:
        offset = register - CONTROL_ADDRESS
        return decode(register, data[offset : offset + LAYOUT[register].size])

    return Control(
        torque_on=value(Register.TORQUE_ENABLE) == 1,
        acceleration=value(Register.ACCELERATION),
        goal_ticks=value(Register.GOAL_POSITION),
        torque_limit_permille=value(Register.TORQUE_LIMIT),
    )
