"""Measurements of one servo, as a family parses them from a reply."""

from __future__ import annotations

from dataclasses import dataclass


# Six hundred are created a second, and a frozen one takes three times as long.
@dataclass(slots=True)
class Telemetry:
    """Measurements of one servo; signs are of the servo's rotation."""

    position_ticks: int  # present position; the tracker takes the turns out that the servo has counted
    velocity_ticks_s: float  # present velocity [ticks/s]
    load: float  # share of full motor duty
    current_a: float  # motor current; NaN for a servo that does not measure it [A]
    voltage_v: float  # supply; NaN in a reply without it [V]
    temperature_c: float  # temperature of the motor; NaN in a reply without it [degC]
    status: int = 0  # bits of :class:`robot.hardware.interface.StatusFlag`
    reports_error: bool = False  # True for a servo whose error register must be read
    turns_ticks: int = 0  # whole turns that were added for the calibrated position
