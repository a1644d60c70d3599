"""Radians of the server to lerobot's units and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

# Start of the keys of the calibrated ranges on /arm/state.
CALIBRATED_RANGE = "calibrated_range_rad."


@dataclass(frozen=True)
class Units:
    """Units of one arm, as lerobot's MotorsBus has them: degrees from the middle, -100 to 100, a gripper's 0 to 100.

    Args:
        range_rad: lower and upper end of each joint: calibrated, else the limits.
        middle_rad: of each joint's calibrated range; 0 for an arm without calibration, such as a simulated one.
    """

    range_rad: Mapping[str, tuple[float, float]]
    middle_rad: Mapping[str, float]
    use_degrees: bool

    def from_rad(self, joint: str, position_rad: float) -> float:
        """Return a position in lerobot's unit."""
        lower, upper = self.range_rad[joint]
        if "gripper" in joint:
            return (position_rad - lower) / (upper - lower) * 100.0
        if self.use_degrees:
            return math.degrees(position_rad - self.middle_rad[joint])
        return (position_rad - lower) / (upper - lower) * 200.0 - 100.0

    def to_rad(self, joint: str, value: float) -> float:
        """Return a position in lerobot's unit in radians."""
        lower, upper = self.range_rad[joint]
        if "gripper" in joint:
            return lower + value / 100.0 * (upper - lower)
        if self.use_degrees:
            return math.radians(value) + self.middle_rad[joint]
        return lower + (value + 100.0) / 200.0 * (upper - lower)


def units_of(
    limits_rad: Mapping[str, tuple[float, float]], state_values: Mapping[str, str], use_degrees: bool
) -> Units:
    """Return the units of an arm.

    Args:
        limits_rad: of ``/arm/joint_limits``.
        state_values: of ``/arm/state``, which has the calibrated ranges of an arm that is calibrated.
    """
    calibrated = {
        key.removeprefix(CALIBRATED_RANGE): (float(lower), float(upper))
        for key, value in state_values.items()
        if key.startswith(CALIBRATED_RANGE)
        for lower, upper in [value.split()]
    }
    middle = {joint: sum(calibrated[joint]) / 2.0 if joint in calibrated else 0.0 for joint in limits_rad}
    return Units({**limits_rad, **calibrated}, middle, use_degrees)
