"""Single reads and verified writes of one servo, as steps that share the bus with the 100 Hz tick."""

from __future__ import annotations

import contextlib

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.registers import Register
from robot.hardware.steps import Steps

# Single packets get lost while other servos draw current; five in a row mean that nobody is there.
ATTEMPTS = 5


def read(bus: Bus, servo_id: int, register: Register) -> Steps[int]:
    """Read one register.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            return bus.read(servo_id, register, attempts=1)
    raise NoReply(servo_id, ATTEMPTS)


def read_block(bus: Bus, servo_id: int, address: int, length: int) -> Steps[StatusFrame]:
    """Read a block of registers of one servo.

    Raises:
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(ATTEMPTS):
        yield 0.0
        frame = bus.sync_read((servo_id,), address, length).get(servo_id)
        if frame is not None:
            return frame
    raise NoReply(servo_id, ATTEMPTS)


def write_verified(bus: Bus, servo_id: int, register: Register, value: int) -> Steps[None]:
    """Write a register until it reads back: the reply to a write that worked may be lost as well.

    Raises:
        StartupError: the servo keeps another value.
        NoReply: the servo gave no valid reply.
        PortLost: the port is gone.
    """
    for _ in range(ATTEMPTS):
        yield 0.0
        with contextlib.suppress(NoReply):
            bus.write(servo_id, register, value, attempts=1)
        if (yield from read(bus, servo_id, register)) == value:
            return
    raise StartupError(f"servo {servo_id} does not take {value} in register {register.name}")
