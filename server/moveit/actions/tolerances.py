"""control_msgs/JointTolerance: how far a joint may be from where a trajectory wants it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.messages import ArmState

Message: TypeAlias = Mapping[str, Any]

# Joint -> greatest distance [rad]. Joints that are not named have what the arm's driver guards anyway.
Tolerances: TypeAlias = Mapping[str, float]


def tolerances_of(messages: Sequence[Message], field: str, joints: Sequence[str]) -> Tolerances | PlanningFailure:
    """Read tolerances; 0 stands for the default and a negative one for no limit, which both demand nothing here.

    Args:
        messages: control_msgs/JointTolerance.
        field: their field, for refusals.
        joints: those that can be named.
    """
    found = {}
    for message in messages:
        name, position_rad = message["name"], message["position"]
        if name not in joints:
            return _invalid(f"{field} names the joint {name!r}; the controller has {', '.join(joints)}", joint=name)
        if math.isnan(position_rad):
            return _invalid(f"{field}: position of joint {name} must be a number, not nan", joint=name)
        if position_rad > 0.0:
            found[name] = float(position_rad)
    return found


def violated(tolerances: Tolerances, state: ArmState, wanted_rad: Mapping[str, float]) -> str:
    """Which joint is too far away, in a sentence; an empty text when none is.

    Args:
        tolerances: of the joints.
        state: where they are.
        wanted_rad: where they should be [rad].
    """
    if state.position_rad is None:
        return ""
    measured = dict(zip(state.joint_names, state.position_rad.tolist(), strict=True))
    for name, tolerance_rad in tolerances.items():
        error_rad = abs(measured[name] - wanted_rad[name])
        if error_rad > tolerance_rad:
            return f"joint {name} is {error_rad:.3f} rad from where it should be (tolerance {tolerance_rad:g} rad)"
    return ""


def _invalid(message: str, **details: Any) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, message, details)
