"""Looks at the numbers that the server sends: the arm process trusts nobody with its guards."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeAlias

from robot.guard_limits import GuardLimits
from robot.messages import ArmConfig

log = logging.getLogger("armbridge.arm")

Ranges: TypeAlias = Mapping[str, tuple[float, float]]

CONFIG_RANGES: Ranges = {
    "state_rate_hz": (1.0, 100.0),
    # Heartbeats come every 0.1 s; less than three of them missed would be taken for the server's death.
    "watchdog_s": (0.3, 10.0),
    # The servos protect themselves at 70 degC.
    "warn_temperature_c": (30.0, 70.0),
    "slow_temperature_c": (30.0, 70.0),
    "stop_temperature_c": (30.0, 70.0),
}

GUARD_RANGES: Ranges = {
    # With less the arm does not hold itself.
    "torque_limit": (0.3, 0.8),
    "gripper_torque_limit": (0.2, 0.5),
    "tracking_error_rad": (0.1, 1.0),
    "tracking_time_s": (0.05, 1.0),
    "stall_current_a": (0.3, 2.7),
    # The servo's own overload timer runs out at 2 s.
    "stall_time_s": (0.1, 1.5),
    # Servos of 7.4 V need 4 V, those of 12 V run from 9 V on.
    "min_voltage_v": (4.0, 11.0),
    # Nearer than its backlash no joint comes.
    "goal_tolerance_rad": (0.02, 0.3),
    "settle_timeout_s": (0.1, 10.0),
}


def checked(config: ArmConfig) -> ArmConfig:
    """The same configuration; a number outside its range, which the server should not have sent, is the default's."""
    return replace(
        config,
        guard_limits=replace(config.guard_limits, **_corrections(config.guard_limits, GUARD_RANGES)),
        **_corrections(config, CONFIG_RANGES),
    )


def _corrections(values: ArmConfig | GuardLimits, ranges: Ranges) -> dict[str, Any]:
    """The defaults of the values out of their ranges; NaN is out of every one."""
    found = {}
    for field in fields(values):
        least, most = ranges.get(field.name, (0.0, 0.0))
        if field.name in ranges and not least <= getattr(values, field.name) <= most:
            log.error("%s must be %g to %g; it is taken as %g", field.name, least, most, field.default)
            found[field.name] = field.default
    return found
