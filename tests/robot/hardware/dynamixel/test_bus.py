from __future__ import annotations

from collections.abc import Sequence

import pytest
from dynamixel_sdk import INST_READ, INST_REBOOT

from robot.emulator.dynamixel import ACCESS_ERROR, DATA_LIMIT_ERROR, DYNAMIXEL, REBOOT_S
from robot.errors import NoReply, StartupError
from robot.hardware.dynamixel.family import Bus
from robot.hardware.dynamixel.packets import instruction_packet, packet
from robot.hardware.dynamixel.registers import Register, encode
from robot.hardware.interface import run_to_end
from robot.hardware.servos.bus import write_verified
from tests.helpers.dynamixel import SteppedDynamixels
from tests.helpers.emulator import SteppedClock


@pytest.fixture
def servos() -> SteppedDynamixels:
    return SteppedDynamixels()


@pytest.fixture
def bus(servos: SteppedDynamixels) -> Bus:
    return servos.open_bus()


def test_the_number_of_a_servos_error_is_told(bus: Bus) -> None:
    assert bus.write(3, Register.GOAL_PWM, 886) == DATA_LIMIT_ERROR
    bus.write(3, Register.TORQUE_ENABLE, 1)
    assert bus.write(3, Register.OPERATING_MODE, 3) == ACCESS_ERROR


def test_a_hardware_error_is_no_error_of_the_instruction(bus: Bus, servos: SteppedDynamixels) -> None:
    servos.servo(3).fail(0x01)
    assert bus.write(3, Register.LED, 1) == 0


def test_a_rebooted_servo_is_silent_for_a_while_and_forgets(bus: Bus, servos: SteppedDynamixels) -> None:
    bus.write(3, Register.BUS_WATCHDOG, 25)
    bus.ask(3, instruction_packet(3, INST_REBOOT), attempts=1)
    with pytest.raises(NoReply):
        bus.ping(3, attempts=1)
    servos.run(REBOOT_S + 0.01)
    assert bus.read(3, Register.BUS_WATCHDOG) == 0


def test_replies_left_on_the_line_are_not_taken_for_the_next(bus: Bus, servos: SteppedDynamixels) -> None:
    servos.port.writePort(packet(3, INST_READ, bytes([Register.ID, 0, 1, 0])))
    assert bus.read(3, Register.TORQUE_ENABLE) == 0
    assert bus.counters.discarded_bytes == len(DYNAMIXEL.status_packet(3, 0, bytes([1])))


class LatePort:
    """Port of one servo that answers every instruction with the next of some replies, each after its time."""

    port_name, baudrate, is_using = "late", 1_000_000, False
    latency_s, quiet_s, discarded_bytes = 0.005, 0.003, 0

    def __init__(self, clock: SteppedClock, replies: list[tuple[float, bytes]]) -> None:
        self._clock = clock
        self._replies = replies
        self._coming: list[tuple[float, bytes]] = []

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name, as below
        return

    def closePort(self) -> None:  # noqa: N802
        return

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802
        delay_s, data = self._replies.pop(0)
        self._coming.append((self._clock() + delay_s, data))
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        due_s = self._coming[0][0] if self._coming else float("inf")
        if due_s > self._clock() + timeout_s:
            self._clock.advance(timeout_s)
            return b""
        self._clock.now_s = max(due_s, self._clock())
        return self._coming.pop(0)[1]


def test_a_reply_that_comes_too_late_is_not_taken_for_the_next() -> None:
    clock = SteppedClock()
    replies = [(0.008, DYNAMIXEL.status_packet(3, 0, bytes([1]))), (0.001, DYNAMIXEL.status_packet(3, 0, bytes([0])))]
    bus = Bus(LatePort(clock, replies), clock)
    with pytest.raises(NoReply):
        bus.read(3, Register.LED, attempts=1)
    assert bus.read(3, Register.TORQUE_ENABLE) == 0


def test_a_stuffed_byte_is_no_noise(bus: Bus, servos: SteppedDynamixels) -> None:
    # FF FF FD FF little endian needs one.
    servos.servo(3).write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, -131073))
    assert bus.read(3, Register.GOAL_POSITION) == -131073
    assert bus.counters.discarded_bytes == 0


def test_a_value_that_is_not_taken_is_told_with_the_servos_error(bus: Bus) -> None:
    bus.write(3, Register.TORQUE_ENABLE, 1)
    with pytest.raises(StartupError, match=r"servo 3 does not take 3 in register OPERATING_MODE \(11\).*error 7"):
        run_to_end(write_verified(bus, 3, Register.OPERATING_MODE, 3))
