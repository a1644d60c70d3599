"""The reasons themselves are shown by the controller's tests; here is what must be accepted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.control.checks import CONFIG_RANGES, GUARD_RANGES, checked, refusal
from robot.description.limits import JointBounds
from robot.hardware.config import IdealConfig
from robot.messages import ArmConfig, GuardLimits
from tests.helpers.arm_rig import NAMES
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

CONFIG = ArmConfig(so101(), IdealConfig())
ALL_RANGES = {**CONFIG_RANGES, **GUARD_RANGES}


def with_value(name: str, value: Any) -> ArmConfig:
    if name in CONFIG_RANGES:
        return replace(CONFIG, **{name: value})
    return replace(CONFIG, guard_limits=replace(GuardLimits(), **{name: value}))


@pytest.mark.parametrize("name", ALL_RANGES)
def test_a_number_within_its_range_is_taken(name: str) -> None:
    assert checked(CONFIG) == CONFIG
    for value in ALL_RANGES[name]:
        assert checked(with_value(name, value)) == with_value(name, value)


@pytest.mark.parametrize("name", ALL_RANGES)
def test_a_number_outside_its_range_becomes_the_default_with_a_log_line(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    least, most = ALL_RANGES[name]
    for value in (least - 0.001, most + 0.001, float("nan"), float("inf")):
        assert checked(with_value(name, value)) == CONFIG
    assert caplog.text.count(f"{name} must be {least:g} to {most:g}") == 4


BOUNDS = JointBounds.of(so101(), NAMES)


@given(st.integers(min_value=0, max_value=5), st.booleans())
def test_a_motion_to_the_very_limit_is_accepted(joint: int, upper: bool) -> None:
    end = float((BOUNDS.upper_rad if upper else BOUNDS.lower_rad)[joint])
    move = smooth_move({NAMES[joint]: (0.0, end)}, duration_s=8.0)
    assert refusal(move, NAMES, BOUNDS, np.zeros(6)) == ""


def test_a_refusal_names_joint_value_and_limit() -> None:
    reason = refusal(smooth_move({"elbow_flex": (0.0, 2.5)}, 8.0), NAMES, BOUNDS, np.zeros(6))
    assert "elbow_flex" in reason
    assert "1.692" in reason


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_times_that_are_no_numbers_are_refused(value: float) -> None:
    move = smooth_move({"elbow_flex": (0.0, 0.5)}, 2.0)
    move.time_s[-1] = value
    assert "finite" in refusal(move, NAMES, BOUNDS, np.zeros(6))
