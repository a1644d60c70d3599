from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest

from robot.emulator.process import PseudoTerminal
from robot.errors import PortNotFound, StartupError
from robot.faults import FaultCode
from robot.hardware.dynamixel.hardware import CLIMATE_EVERY, DynamixelHardware, SerialDynamixels
from robot.hardware.dynamixel.registers import Register, encode
from robot.hardware.dynamixel.survey import CYCLES_BETWEEN
from robot.hardware.interface import StatusFlag, run_to_end
from robot.messages import GuardLimits, Mode, Order, Outcome
from tests.helpers.dynamixel import BOUNDS, CALIBRATION, METAL, NAMES, DynamixelRig, DynamixelsInUse, SteppedDynamixels
from tests.helpers.motions import smooth_move


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels()


@pytest.fixture
def servos(dynamixels: SteppedDynamixels) -> DynamixelsInUse:
    return DynamixelsInUse(dynamixels)


@pytest.fixture
def rig(dynamixels: SteppedDynamixels) -> DynamixelRig:
    made = DynamixelRig(dynamixels, start_enabled=False)
    made.until_mode(Mode.RELAXED)
    return made


def test_a_cycle_is_one_block_read_and_one_goal_write(rig: DynamixelRig) -> None:
    rig.order(Order.ENABLE)
    arm = rig.supervisor.arm
    assert arm is not None
    assert arm.hardware.counters is not None
    before = arm.hardware.counters.sent
    for _ in range(CYCLES_BETWEEN):
        arm.tick()
    assert arm.hardware.counters.sent - before == CYCLES_BETWEEN * 2 + 1


def test_an_arm_follows_a_trajectory_and_is_relaxed_again(rig: DynamixelRig) -> None:
    rig.order(Order.ENABLE)
    rig.until_mode(Mode.HOLDING)
    rig.execute(smooth_move({"elbow_flex": (0.0, -0.7), "wrist_roll": (0.0, 1.5)}, 2.0))
    rig.until(lambda: bool(rig.ended))
    assert rig.ended[0].outcome.value == "reached"
    assert rig.state.position_rad is not None
    assert rig.state.position_rad[[2, 4]] == pytest.approx([-0.7, 1.5], abs=0.02)
    assert rig.order(Order.RELAX).done
    assert rig.torque() == [0] * 6


def test_a_gripper_that_closes_on_something_has_gripped_it() -> None:
    dynamixels = SteppedDynamixels(start_rad={"gripper": 1.2})
    rig = DynamixelRig(dynamixels)
    rig.until_mode(Mode.HOLDING)
    rig.run(1.0)
    gripper = CALIBRATION.joints[5]
    dynamixels.servo(6).plant.block(gripper.ticks_from_rad(0.7) - gripper.homing_offset)
    rig.execute(smooth_move({"gripper": (1.2, 0.2)}, 1.5), gripping=True)
    rig.until(lambda: bool(rig.ended))
    assert rig.ended[0].outcome is Outcome.GRIPPED
    assert rig.fault_code == ""
    rig.run(3.0)
    assert rig.mode is Mode.HOLDING
    # Squeezing for long takes half of the torque.
    assert dynamixels.servo(6).value(Register.GOAL_CURRENT) == round(0.25 * 1470)


def test_the_soft_limits_end_before_the_turns_become_ambiguous(dynamixels: SteppedDynamixels) -> None:
    wide = replace(BOUNDS, lower_rad=np.full(6, -7.0), upper_rad=np.full(6, 7.0))
    hardware = DynamixelHardware(dynamixels.open_bus(), METAL, wide, GuardLimits(), dynamixels.clock)
    bounds = run_to_end(hardware.survey()).bounds
    assert max(bounds.upper_rad[:5]) < math.pi - 0.3
    assert min(bounds.lower_rad[:5]) > -math.pi + 0.3


def test_goals_of_a_servo_that_counts_turns_are_in_its_turns(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3)._turns_ticks += 4096
    servos = DynamixelsInUse(dynamixels)
    servos.enable()
    servos.hardware.write_goals(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]))
    assert servos.read(0.4).position_rad[2] == pytest.approx(0.2, abs=0.01)


def test_supply_and_temperature_are_read_less_often(servos: DynamixelsInUse) -> None:
    servo = servos.emulator.servo(3)
    servo.voltage_v = 5.6
    readings = [servos.read().voltage_v[2] for _ in range(2 * CLIMATE_EVERY)]
    assert readings[0] == pytest.approx(5.0)
    assert readings[-1] == pytest.approx(5.6)


def test_an_arm_without_calibration_is_read_but_never_enabled(dynamixels: SteppedDynamixels) -> None:
    servos = DynamixelsInUse(dynamixels, replace(METAL, calibration=replace(CALIBRATION, measured=False)))
    with pytest.raises(StartupError, match=r"no calibration says where the joints' zero is.*--calibration"):
        servos.enable()
    assert dynamixels.writes() == 0
    assert servos.read().position_rad.shape == (6,)


def test_an_arm_whose_servos_have_another_calibration_is_never_enabled(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).write(Register.HOMING_OFFSET, encode(Register.HOMING_OFFSET, -1690))
    servos = DynamixelsInUse(dynamixels)
    before = dynamixels.writes()
    with pytest.raises(StartupError, match="homing offset -1690"):
        servos.enable()
    assert dynamixels.writes() == before


def test_an_uncalibrated_arm_that_is_found_holding_goes_on_holding(dynamixels: SteppedDynamixels) -> None:
    for servo in dynamixels.servo_bus.servos:
        servo.hold()
    rig = DynamixelRig(dynamixels, hardware=replace(METAL, calibration=replace(CALIBRATION, measured=False)))
    rig.until_mode(Mode.FAULT)
    rig.run(1.0)
    assert rig.fault_code == FaultCode.STARTUP_REFUSED.value
    assert rig.torque() == [1] * 6
    assert rig.state.position_rad == pytest.approx(np.zeros(6), abs=0.01)


def test_a_hardware_error_is_read_where_a_servo_reports_one(servos: DynamixelsInUse) -> None:
    servos.emulator.servo(3).fail(0x24)
    measured = servos.read()
    assert measured.status.tolist() == [0, 0, int(StatusFlag.TEMPERATURE | StatusFlag.OVERLOAD), 0, 0, 0]


@pytest.mark.parametrize(("bits", "code"), [(0x20, FaultCode.OVERLOAD), (0x04, FaultCode.OVERHEATED)])
def test_a_servo_that_has_protected_itself_is_a_fault_that_can_be_reset(
    dynamixels: SteppedDynamixels, bits: int, code: FaultCode
) -> None:
    rig = DynamixelRig(dynamixels)
    rig.until(lambda: rig.mode is Mode.HOLDING)
    rig.run(1.0)
    dynamixels.servo(3).fail(bits)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == code.value
    # The rest of the arm is relaxed by itself.
    rig.run(3.0)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done, answer.message
    assert rig.order(Order.ENABLE).done
    rig.run(0.5)
    assert rig.mode is Mode.HOLDING
    assert rig.torque() == [1] * 6


def test_a_servo_that_reboots_is_noticed(servos: DynamixelsInUse) -> None:
    servos.enable()
    servos.emulator.servo(3).power_up()
    faults = [servos.hardware.check(5.0) for _ in range(12 * CYCLES_BETWEEN)]
    codes = {(fault.code, fault.joint, fault.stamp_s) for fault in faults if fault is not None}
    assert codes == {
        (FaultCode.TORQUE_LOST, "elbow_flex", 5.0),
        (FaultCode.SERVO_REBOOTED, "elbow_flex", 5.0),
    }


def test_servos_stop_by_themselves_when_the_host_dies(servos: DynamixelsInUse) -> None:
    servos.enable()
    servos.hardware.write_goals(np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    servos.emulator.run(0.6)
    stopped_rad = servos.read().position_rad[0]
    servos.emulator.run(2.0)
    assert servos.emulator.registers(Register.BUS_WATCHDOG) == [-1] * 6
    assert servos.read().position_rad[0] == pytest.approx(stopped_rad, abs=0.05)
    assert stopped_rad < 1.4
    assert servos.emulator.registers(Register.TORQUE_ENABLE) == [1] * 6


def test_servos_do_not_stop_while_the_host_reads_or_writes(servos: DynamixelsInUse) -> None:
    servos.enable()
    servos.hold_for(2.0)
    assert -1 not in servos.emulator.registers(Register.BUS_WATCHDOG)


def test_a_host_that_was_away_takes_the_stopped_servos_over(dynamixels: SteppedDynamixels) -> None:
    DynamixelsInUse(dynamixels).enable()
    dynamixels.run(3.0)
    rig = DynamixelRig(dynamixels)
    rig.until_mode(Mode.HOLDING)
    rig.until(lambda: -1 not in dynamixels.registers(Register.BUS_WATCHDOG))
    rig.execute(smooth_move({"wrist_roll": (rig.state.goal_rad[4], 0.8)}, 2.0))  # type: ignore[index]
    rig.until(lambda: bool(rig.ended))
    assert rig.ended[0].outcome.value == "reached"
    assert rig.torque() == [1] * 6


def test_a_servo_that_was_stopped_alone_is_a_fault_that_can_be_reset(dynamixels: SteppedDynamixels) -> None:
    rig = DynamixelRig(dynamixels)
    rig.until_mode(Mode.HOLDING)
    rig.run(1.0)
    dynamixels.servo(2).set(Register.BUS_WATCHDOG, -1)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == FaultCode.SERVO_SILENT.value
    assert rig.order(Order.RESET_FAULT).done
    rig.run(3.0)
    assert rig.mode is Mode.HOLDING
    assert -1 not in dynamixels.registers(Register.BUS_WATCHDOG)


def test_closing_leaves_the_servos_holding_without_a_watchdog(servos: DynamixelsInUse) -> None:
    servos.enable()
    servos.hardware.close()
    assert servos.emulator.registers(Register.TORQUE_ENABLE) == [1] * 6
    assert servos.emulator.registers(Register.BUS_WATCHDOG) == [0] * 6


def test_closing_an_arm_that_was_never_driven_writes_nothing(servos: DynamixelsInUse) -> None:
    servos.hardware.close()
    assert servos.emulator.writes() == 0


def test_closing_a_lost_port_is_no_error(servos: DynamixelsInUse) -> None:
    servos.enable()
    servos.emulator.port.unplug()
    servos.hardware.close()


def test_a_port_is_opened_with_the_baud_rate_of_its_configuration() -> None:
    source = SerialDynamixels(METAL, BOUNDS, GuardLimits(), lambda: 0.0)
    with pytest.raises(PortNotFound):
        source.open()
    with contextlib.closing(PseudoTerminal()) as terminal:
        config = replace(METAL, port=terminal.port, baud=57_600)
        with contextlib.closing(SerialDynamixels(config, BOUNDS, GuardLimits(), lambda: 0.0).open()) as hardware:
            assert hardware.joint_names == NAMES
            assert isinstance(hardware, DynamixelHardware)
            assert hardware.bus._port.baudrate == 57_600
