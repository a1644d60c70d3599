from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from robot import model
from robot.control.config_check import CONFIG_RANGES, GUARD_RANGES, checked
from robot.guard_limits import GuardLimits
from robot.hardware.config import IdealConfig
from robot.messages import ArmConfig

CONFIG = ArmConfig(model.builtin(), IdealConfig())
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
def test_a_number_outside_its_range_is_the_default_and_told(name: str, caplog: pytest.LogCaptureFixture) -> None:
    least, most = ALL_RANGES[name]
    for value in (least - 0.001, most + 0.001, float("nan"), float("inf")):
        assert checked(with_value(name, value)) == CONFIG
    assert caplog.text.count(f"{name} must be {least:g} to {most:g}") == 4
