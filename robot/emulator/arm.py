"""Emulated arm: its servos at a pose, and the weight of its links on them. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.description.gravity import LinkWeights
from robot.description.model import RobotModel
from robot.emulator.plant import Plant
from robot.emulator.servo import Servo

# Far less than the stall torque of 1.62 Nm suggests: friction in the gear carries most of a resting joint's weight.
# The droop is then 1 deg at a stretched shoulder with lerobot's gain, as measured without backlash.
DUTY_PERMILLE_PER_NM = 110.0


def build_servos(calibration: Calibration, start_rad: Sequence[float]) -> list[Servo]:
    """Build the arm's servos at a pose.

    Args:
        calibration: ids, angle limits and homing offsets; its ranges are the joints' mechanical stops.
        start_rad: position of each joint, in the calibration's order [rad].

    Raises:
        ValueError: the pose has another number of joints, or lies outside the ranges.
    """
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [_servo(joint, position) for joint, position in zip(calibration.joints, start_rad, strict=True)]


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
        position_rad = {
            joint.joint: joint.rad_from_ticks(servo.plant.position_ticks - joint.homing_offset)
            for joint, servo in joints
        }
        if all(
            abs(position - weighed.get(name, math.inf)) < WEIGHED_AGAIN_RAD for name, position in position_rad.items()
        ):
            return
        weighed.update(position_rad)
        torques_nm = weights.holding_torques(position_rad)
        for joint, servo in joints:
            # The plant counts in ticks, which may fall while the joint's position rises.
            sign = math.copysign(1.0, joint.rad_s_from_ticks_s(1.0))
            servo.plant.gravity_permille = sign * DUTY_PERMILLE_PER_NM * torques_nm[joint.joint]

    return weigh


def _servo(joint: JointCalibration, start_rad: float) -> Servo:
    if not joint.lower_rad <= start_rad <= joint.upper_rad:
        raise ValueError(
            f"{joint.joint} cannot start at {start_rad:g} rad, outside its range of "
            f"{joint.lower_rad:.3f} to {joint.upper_rad:.3f}"
        )
    offset = joint.homing_offset
    plant = Plant(
        position_ticks=joint.ticks_from_rad(start_rad) + offset,
        lower_stop_ticks=joint.range_min + offset,
        upper_stop_ticks=joint.range_max + offset,
    )
    return Servo(joint.servo_id, plant, (joint.range_min, joint.range_max), offset)
