"""Radians of the server to lerobot's units and back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

# Arm, ranges and zeros of a dataset that `armbridge export` has written.
ARM_PATH = "meta/armbridge.json"

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


# Calibrations of one arm by hand differ by less [degrees].
SAME_WITHIN_DEG = 1.0


def difference(recorded: Units, present: Units) -> str:
    """Describe the joint whose zero or range differs most from the recorded arm's; empty where none differs."""
    worst, joint = 0.0, ""
    for name, zero_rad in recorded.middle_rad.items():
        here_rad, there_rad = [*present.range_rad[name]], [*recorded.range_rad[name]]
        # A gripper's percent count from its range alone.
        if "gripper" not in name:
            here_rad.append(present.middle_rad[name])
            there_rad.append(zero_rad)
        away = max(math.degrees(abs(here - there)) for here, there in zip(here_rad, there_rad, strict=True))
        if away > worst:
            worst, joint = away, name
    if worst <= SAME_WITHIN_DEG:
        return ""
    return f"zero or range of {joint} differ by {worst:.1f} degrees from this arm's (limit {SAME_WITHIN_DEG:g})"


def units_of_dataset(folder: Path, server_names: Mapping[str, str], *, use_degrees: bool) -> Units:
    """Return the units of the arm that recorded a dataset, by this server's names of its joints.

    Raises:
        ValueError: the dataset does not name its arm, or is in other units.
    """
    path = folder / ARM_PATH
    try:
        arm = json.loads(path.read_text())
        joints = {server: arm["joints"][server] for server in server_names.values()}
        ranges = {name: (float(each["range_rad"][0]), float(each["range_rad"][1])) for name, each in joints.items()}
        zeros = {name: float(each["zero_rad"]) for name, each in joints.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"dataset: {path} names no zero and range of the joints {[*server_names]}: {error}") from error
    if arm["units"] != "lerobot" or not use_degrees:
        raise ValueError(f"dataset: {folder} is in {arm['units']}: export it with --units lerobot, and use degrees")
    return Units(ranges, zeros, use_degrees)


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
