"""Emulated arm with Feetech servos: its servos at a pose, in the state of a population, and its hardware source."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm, start_pose_rad
from robot.emulator.feetech import FEETECH, FeetechServo
from robot.emulator.plant import Plant
from robot.emulator.populations import FACTORY, POPULATIONS, Population
from robot.emulator.write_log import WriteLog
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.family import Feetech
from robot.hardware.feetech.registers import Register
from robot.messages import GuardLimits


def emulated_feetech_arm(
    robot: RobotModel, config: EmulatedConfig, bounds: JointBounds, limits: GuardLimits, clock: Callable[[], float]
) -> EmulatedArm[FeetechServo]:
    """Build the emulated Feetech servos of an arm.

    Raises:
        OSError: the log or the control socket cannot be created.
    """
    population = POPULATIONS[config.population]
    servos = build_servos(config.calibration, start_pose_rad(config), population, as_read=config.resumes)
    holds = config.driven and (config.resumes or not population.has_shifted)
    log = WriteLog(config.write_log, append=config.resumes) if config.write_log else None
    arm = EmulatedArm(robot, config, Feetech(config.profile), servos, FEETECH, bounds, limits, clock, log, holds=holds)
    if config.control:
        # Only here: most arms take no commands, and pydantic takes its time.
        from robot.emulator.control_socket import CommandedPort, ControlSocket

        arm.port = CommandedPort(arm.bus, clock, ControlSocket(config.control))
    return arm


def build_servos(
    calibration: Calibration, start_rad: Sequence[float], population: Population = FACTORY, *, as_read: bool = False
) -> list[FeetechServo]:
    """Build the arm's servos at a pose [rad]; the calibrated ranges are the joints' mechanical stops.

    ``as_read`` is True if the pose is the one that the calibration makes of the servos' readings, which may have
    another zero.

    Raises:
        ValueError: the pose has another number of joints, or lies outside the ranges.
    """
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [
        _servo(place, joint, position, population, as_read=as_read)
        for place, (joint, position) in enumerate(zip(calibration.joints, start_rad, strict=True))
    ]


def _servo(
    place: int, joint: JointCalibration, start_rad: float, population: Population, *, as_read: bool
) -> FeetechServo:
    if not joint.lower_rad <= start_rad <= joint.upper_rad:
        raise ValueError(
            f"{joint.joint} cannot start at {start_rad:g} rad, outside its range of "
            f"{joint.lower_rad:.3f} to {joint.upper_rad:.3f}"
        )

    def own(each: Sequence[int]) -> int:
        """Return the value of this joint."""
        return each[place % len(each)]

    zero = joint.homing_offset + own(population.horn_ticks)
    offset = (joint.homing_offset if population.has_offsets else 0) + own(population.offset_shift_ticks)
    lower_stop, upper_stop = joint.range_min + zero, joint.range_max + zero
    if joint.servo.turns_freely and population.free_joint_stops_ticks is not None:
        lower_stop, upper_stop = (stop + zero for stop in population.free_joint_stops_ticks)
    start = joint.ticks_from_rad(start_rad) + (offset if as_read else zero)
    plant = Plant(max(lower_stop, min(upper_stop, start)), lower_stop, upper_stop)
    lowest, highest = population.limits_ticks or (joint.range_min, joint.range_max)
    eprom = {
        Register.ID: joint.servo_id if population.servo_id is None else population.servo_id,
        Register.MIN_ANGLE_LIMIT: lowest,
        Register.MAX_ANGLE_LIMIT: highest,
        Register.HOMING_OFFSET: offset,
        Register.FIRMWARE_MINOR: own(population.firmware),
        **population.registers,
        **(population.gripper if joint.servo.gripper else {}),
    }
    servo = FeetechServo(plant, eprom, joint=joint.joint, zero_ticks=zero)
    if joint.servo.gripper:
        servo.motor.heating = population.gripper_heating
    servo.voltage_v = population.supply_v
    servo.protection.latches = population.overload_latches
    servo.powers_up_holding = population.powers_up_holding
    servo.powers_up_unlocked = population.powers_up_unlocked
    servo.power_up()
    if population.unlocked:
        servo.set(Register.LOCK, 0)
    return servo
