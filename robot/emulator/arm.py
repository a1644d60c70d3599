"""The emulated arm: six servos at a pose, and the weight that they carry."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.emulator.gravity import holding_duty_permille
from robot.emulator.plant import Plant
from robot.emulator.servo import Servo


def build_servos(calibration: Calibration, start_rad: Sequence[float]) -> list[Servo]:
    """Build the arm's servos at a pose.

    Args:
        calibration: ids, angle limits and homing offsets; its ranges are the joints' mechanical stops.
        start_rad: position of each joint of the calibration, in its order [rad].

    Raises:
        ValueError: the pose has another number of joints, or lies outside the ranges.
    """
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [_servo(joint, position) for joint, position in zip(calibration.joints, start_rad, strict=True)]


def weight_of(calibration: Calibration, servos: Sequence[Servo]) -> Callable[[], None]:
    """Return what puts the links' weight, as it is at the present pose, on the servos."""
    joints = list(zip(calibration.joints, servos, strict=True))

    def weigh() -> None:
        position_rad = {
            joint.joint: joint.rad_from_ticks(servo.plant.position_ticks - joint.homing_offset)
            for joint, servo in joints
        }
        duty_permille = holding_duty_permille(position_rad)
        for joint, servo in joints:
            servo.plant.gravity_permille = duty_permille.get(joint.joint, 0.0)

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
