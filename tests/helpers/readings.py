"""Readings of servos that are well, but for what a test says."""

from __future__ import annotations

from typing import Any

import numpy as np

from robot.hardware.interface import Measured


def reading(position_rad: Any, **told: Any) -> Measured:
    """What six servos measure; every named value is one number for all joints, or six."""
    usual = {
        "velocity_rad_s": 0.0,
        "load": 0.0,
        "current_a": 0.0,
        "voltage_v": 6.0,
        "temperature_c": 35.0,
        "status": 0,
        "age_s": 0.0,
    }
    columns = {name: np.broadcast_to(np.asarray(value), (6,)) for name, value in (usual | told).items()}
    return Measured(position_rad=np.asarray(position_rad, dtype=float), **columns)
