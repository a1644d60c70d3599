from __future__ import annotations

import pytest

from robot.errors import NoReply, StartupError
from robot.hardware.feetech.bus import STEP_ATTEMPTS, Bus, read, read_block, write_verified
from robot.hardware.feetech.registers import Register
from tests.helpers.sequences import run
from tests.helpers.stepped_emulator import SteppedEmulator


def test_a_step_is_one_transaction(bus: Bus) -> None:
    for _ in write_verified(bus, 1, Register.TORQUE_LIMIT, 400):
        sent = bus.counters.sent
    assert bus.counters.sent <= sent + 1
    assert bus.read(1, Register.TORQUE_LIMIT) == 400


def test_a_silent_servo_is_asked_a_bounded_number_of_times(emulator: SteppedEmulator, bus: Bus) -> None:
    emulator.command(offline=[1])
    with pytest.raises(NoReply):
        run(read(bus, 1, Register.TORQUE_ENABLE))
    assert bus.counters.sent == STEP_ATTEMPTS
    with pytest.raises(NoReply):
        run(read_block(bus, 1, 40, 16))


def test_a_register_that_keeps_another_value_is_told(bus: Bus) -> None:
    with pytest.raises(StartupError, match="does not take 5 in register PRESENT_TEMPERATURE"):
        run(write_verified(bus, 1, Register.PRESENT_TEMPERATURE, 5))


def test_a_block_is_read_in_one_piece(bus: Bus) -> None:
    assert len(run(read_block(bus, 1, Register.TORQUE_ENABLE, 16)).data) == 16
