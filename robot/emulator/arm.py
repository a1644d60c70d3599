"""Emulated arm: its servos at a pose, and the weight of its links on them. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.description.gravity import LinkWeights
from robot.description.model import RobotModel
from robot.emulator.plant import Plant
from robot.emulator.populations import FACTORY, Population
from robot.emulator.servo import Servo
from robot.hardware.feetech.registers import Register

# Far less than the stall torque of 1.62 Nm suggests: friction in the gear carries most of a resting joint's weight.
# With lerobot's gain the droop is then 14 ticks (1.2 deg) at a stretched shoulder, and 24 with 1.5 kg at 10 cm, where
# 20 to 30 were measured.
DUTY_PERMILLE_PER_NM = 130.0


def build_servos(
    calibration: Calibration, start_rad: Sequence[float], population: Population = FACTORY, *, as_read: bool = False
) -> list[Servo]:
    """Build the arm's servos at a pose.

    Args:
        calibration: ids, angle limits and homing offsets; its ranges are the joints' mechanical stops.
        start_rad: position of each joint, in the calibration's order [rad].
        population: state of the servos.
        as_read: True if the pose is the one that the calibration makes of the servos' readings, which may have another
            zero.

    Raises:
        ValueError: the pose has another number of joints, or lies outside the ranges.
    """
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [
        _servo(place, joint, position, population, as_read=as_read)
        for place, (joint, position) in enumerate(zip(calibration.joints, start_rad, strict=True))
    ]


# A joint that turns by less changes its weight by less than the servo's load resolves [rad].
WEIGHED_AGAIN_RAD = 0.005


def weight_of(robot: RobotModel, calibration: Calibration, servos: Sequence[Servo]) -> Callable[[], None]:
    """Return a function that loads the servos with the links' weight at the present pose.

    Args:
        robot: description of the arm.
        calibration: joints of the servos.
        servos: in the order of the calibration.
    """
    weights = LinkWeights(robot)
    joints = list(zip(calibration.joints, servos, strict=True))
    weighed: dict[str, float] = {}

    def weigh() -> None:
        """Load the servos with the weight at the present pose."""
        position_rad = {joint.joint: joint.rad_from_ticks(servo.joint_ticks) for joint, servo in joints}
        if all(
            abs(position - weighed.get(name, math.inf)) < WEIGHED_AGAIN_RAD for name, position in position_rad.items()
        ):
            return
        weighed.update(position_rad)
        torques_nm = weights.holding_torques(position_rad)
        for joint, servo in joints:
            # The plant counts in ticks, which may fall while the joint's position rises.
            sign = math.copysign(1.0, joint.rad_s_from_ticks_s(1.0)) * (-1.0 if servo.mirrored else 1.0)
            servo.plant.gravity_permille = sign * DUTY_PERMILLE_PER_NM * torques_nm[joint.joint]

    return weigh


def _servo(place: int, joint: JointCalibration, start_rad: float, population: Population, *, as_read: bool) -> Servo:
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
    servo = Servo(plant, eprom, joint=joint.joint, zero_ticks=zero)
    if joint.servo.gripper:
        servo.motor.heating = population.gripper_heating
    servo.voltage_v = population.supply_v
    servo.protection.latches = population.overload_latches
    servo.powers_up_holding = population.powers_up_holding
    servo.powers_up_unlocked = population.powers_up_unlocked
    servo.power_up()
    if population.unlocked:
        servo.write(Register.LOCK, bytes([0]))
    return servo
