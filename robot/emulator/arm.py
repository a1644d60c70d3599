"""Emulated SO-101: six servos at a pose, and the weight of the links on the three joints that carry it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.emulator.plant import Plant
from robot.emulator.servo import Servo

# Static torque of the links with nothing in the jaw, from the masses in the URDF [Nm]: the upper arm with all that
# hangs on its end, the forearm with the hand, and the hand.
UPPER_ARM_NM = 0.39
FOREARM_NM = 0.336
HAND_NM = 0.117

# The upper arm's centre of gravity is above the shoulder at minus this angle of shoulder_lift [rad].
UPPER_ARM_LEAN_RAD = 0.22

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


def weight_of(calibration: Calibration, servos: Sequence[Servo]) -> Callable[[], None]:
    """Return a function that loads the servos with the links' weight at the present pose."""
    joints = list(zip(calibration.joints, servos, strict=True))

    def weigh() -> None:
        """Load the servos with the weight at the present pose."""
        position_rad = {
            joint.joint: joint.rad_from_ticks(servo.plant.position_ticks - joint.homing_offset)
            for joint, servo in joints
        }
        duty_permille = holding_duty_permille(position_rad)
        for joint, servo in joints:
            servo.plant.gravity_permille = duty_permille.get(joint.joint, 0.0)

    return weigh


def holding_duty_permille(position_rad: Mapping[str, float]) -> dict[str, float]:
    """Compute the motor duty that balances the links' weight, for each joint that carries some.

    Args:
        position_rad: joint name to position [rad], of shoulder_lift, elbow_flex and wrist_flex at least.

    Returns:
        Joint name to signed duty [0.1 %].
    """
    upper_arm = position_rad["shoulder_lift"]
    forearm = upper_arm + position_rad["elbow_flex"]
    hand = forearm + position_rad["wrist_flex"]
    wrist_nm = -HAND_NM * math.cos(hand)
    elbow_nm = wrist_nm - FOREARM_NM * math.cos(forearm)
    shoulder_nm = elbow_nm - UPPER_ARM_NM * math.sin(upper_arm + UPPER_ARM_LEAN_RAD)
    torque_nm = {"shoulder_lift": shoulder_nm, "elbow_flex": elbow_nm, "wrist_flex": wrist_nm}
    return {joint: DUTY_PERMILLE_PER_NM * value for joint, value in torque_nm.items()}


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
