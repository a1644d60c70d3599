"""The weight of an SO-101's links on the three joints that carry it, by the arm's pose. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

# Static torque of the links with nothing in the jaw, from the masses in the URDF [Nm]: the upper arm with all that
# hangs on its end, the forearm with the hand, and the hand.
UPPER_ARM_NM = 0.39
FOREARM_NM = 0.336
HAND_NM = 0.117

# The upper arm's line of gravity stands upright at this shoulder_lift less than 0 [rad].
UPPER_ARM_LEAN_RAD = 0.22

# Far less than the stall torque of 1.62 Nm suggests: friction in the gear carries most of a resting joint's weight.
# The droop is then 1 deg at a stretched shoulder with lerobot's gain, as measured without backlash.
DUTY_PERMILLE_PER_NM = 110.0


def holding_duty_permille(position_rad: Mapping[str, float]) -> dict[str, float]:
    """Compute the duty that carries the weight of each joint that has some to carry.

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
