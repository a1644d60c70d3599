from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.emulator.process import PseudoTerminal
from robot.errors import PortNotFound, StartupError
from robot.faults import FaultCode
from robot.hardware.config import FeetechConfig
from robot.hardware.feetech.hardware import (
    FeetechHardware,
    SerialServos,
    ServoWatch,
)
from robot.hardware.feetech.packets import StatusFrame
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.feetech.survey import CYCLES_BETWEEN
from robot.hardware.interface import StatusFlag, run_to_end
from robot.messages import GuardLimits, Mode
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, NAMES, ArmRig
from tests.helpers.emulator import SteppedClock, SteppedEmulator
from tests.helpers.feetech import FeetechsInUse

SERVOS = ServoMap(CALIBRATION, BOUNDS)


def frame(servo_id: int, ticks: int = 2048, error: int = 0) -> StatusFrame:
    data = encode(Register.PRESENT_POSITION, ticks).ljust(15, b"\0")
    return StatusFrame(servo_id, error, data)


def test_positions_are_those_of_the_calibration() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, 1800 + servo) for servo in asked}, 0.0)
    expected = [joint.rad_from_ticks(1800 + joint.servo_id) for joint in CALIBRATION.joints]
    assert watch.measured(0.0, 0.0).position_rad == pytest.approx(expected)


def test_the_error_byte_of_the_reply_counts_as_status() -> None:
    watch = ServoWatch(SERVOS)
    asked = watch.ids_to_ask()
    watch.take(asked, {servo: frame(servo, error=int(StatusFlag.OVERLOAD)) for servo in asked}, 0.0)
    assert watch.measured(0.0, 0.0).status[0] == StatusFlag.OVERLOAD


def test_a_cycle_is_one_block_read_and_one_goal_write(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator)
    rig.until_mode(Mode.HOLDING)
    arm = rig.supervisor.arm
    assert arm is not None
    before = rig.bus.counters.sent
    for _ in range(16):
        arm.tick()
    # Every sixteenth cycle one servo is read back.
    assert rig.bus.counters.sent - before == 16 * 2 + 1


def test_the_soft_limits_are_narrowed_to_what_the_servos_allow(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(1, Register.MAX_ANGLE_LIMIT, CALIBRATION.joints[0].ticks_from_rad(0.5))
    found = FeetechsInUse(emulator).found
    assert found.bounds.upper_rad[0] == pytest.approx(0.5, abs=0.05)
    assert found.bounds.upper_rad[1:] == pytest.approx(BOUNDS.upper_rad[1:])


def test_changed_goals_are_written_at_once(servos: FeetechsInUse) -> None:
    written = []
    for pan_rad in (0.1, 0.2):
        servos.hardware.write_goals(np.array([pan_rad, 0.0, 0.0, 0.0, 0.0, 0.0]))
        written.append(servos.hardware.bus.read(1, Register.GOAL_POSITION))
    assert written == [CALIBRATION.joints[0].ticks_from_rad(pan_rad) for pan_rad in (0.1, 0.2)]


def test_every_servo_is_looked_at_in_its_turn(servos: FeetechsInUse) -> None:
    servos.enable()
    servos.emulator.command(power_cycle=[3])
    faults = [servos.hardware.check(5.0) for _ in range(6 * CYCLES_BETWEEN)]
    (fault,) = [fault for fault in faults if fault is not None]
    assert (fault.code, fault.joint, fault.stamp_s) == (FaultCode.SERVO_REBOOTED, "elbow_flex", 5.0)


def test_round_trips_are_timed_on_the_loops_clock(servos: FeetechsInUse) -> None:
    assert 0.001 < servos.hardware.round_trips_s[-1] < 0.003


class Adapter:
    """The one USB adapter that is plugged in, wherever that is."""

    device = "/dev/does-not-exist"

    @classmethod
    def comports(cls) -> list[ListPortInfo]:
        info = ListPortInfo(cls.device)
        info.vid, info.pid = 0x1A86, 0x55D3
        return [info]


def test_an_adapter_is_looked_for_anew_each_time_that_it_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", Adapter.comports)
    source = SerialServos(FeetechConfig(CALIBRATION, "auto"), BOUNDS, GuardLimits(), SteppedClock())
    with pytest.raises(PortNotFound):
        source.open()
    with contextlib.closing(PseudoTerminal()) as terminal:
        monkeypatch.setattr(Adapter, "device", terminal.port)
        with contextlib.closing(source.open()) as hardware:
            assert hardware.joint_names == NAMES


@pytest.fixture
def servos(emulator: SteppedEmulator) -> FeetechsInUse:
    return FeetechsInUse(emulator)


def assumed(emulator: SteppedEmulator, *, simulated: bool) -> FeetechHardware:
    """Hardware whose calibration nobody has measured."""
    calibration = replace(CALIBRATION, measured=False)
    hardware = FeetechHardware(
        emulator.open_bus(), calibration, BOUNDS, GuardLimits(), emulator.clock, simulated=simulated
    )
    run_to_end(hardware.survey())
    return hardware


def test_a_real_arm_whose_zero_nobody_has_measured_is_not_enabled(emulator: SteppedEmulator) -> None:
    hardware = assumed(emulator, simulated=False)
    with pytest.raises(StartupError, match="no calibration says where the joints' zero is"):
        run_to_end(hardware.enable(range(6)), emulator.run)
    assert not run_to_end(hardware.driven(), emulator.run).any()


def test_an_emulated_arm_needs_no_calibration(emulator: SteppedEmulator) -> None:
    hardware = assumed(emulator, simulated=True)
    run_to_end(hardware.enable(range(6)), emulator.run)
    assert run_to_end(hardware.driven(), emulator.run).all()
