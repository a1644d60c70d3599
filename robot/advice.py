"""Alerts of a servo: the meaning of each, and what to do about it.

An alert is a status flag, an event that was counted, or a warning. Where a fault belongs to it, the remedy is the
remedy of the fault (:mod:`robot.faults`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from robot.faults import FaultCode, remedy_of


class ServoAlert(Enum):
    """Alerts; status flags and counted errors have the names by which ``/diagnostics`` counts them."""

    VOLTAGE = "voltage"
    ENCODER = "encoder"
    TEMPERATURE = "temperature"
    CURRENT = "current"
    ANGLE = "angle"
    OVERLOAD = "overload"
    SERVO_REBOOTED = "servo_rebooted"
    TORQUE_LOST = "torque_lost"
    SILENT_CYCLES = "silent_cycles"
    NO_ANSWER = "no_answer"
    WARM = "warm"
    SLOWED = "slowed"
    ANGLE_LIMITS = "angle_limits"
    POSITION_LIMITS = "position_limits"
    SEVERAL_TURNS = "several_turns"
    MODEL = "model"
    FIRMWARE = "firmware"
    REGISTER = "register"
    RETURN_DELAY = "return_delay"
    EPROM_UNLOCKED = "eprom_unlocked"
    NO_WATCHDOG = "no_watchdog"


class ServoWarning(NamedTuple):
    """Warning about one servo."""

    alert: ServoAlert
    sentence: str  # one sentence with figures, which change from report to report
    register: str = ""  # register concerned, where a servo may have several warnings of the kind; else empty


@dataclass(frozen=True)
class Advice:
    """Advice on an alert."""

    means: str  # meaning of the alert, without a full stop
    do: str | FaultCode  # what to do, one or two sentences; for a code, the remedy of that fault

    def remedy(self, *, simulated: bool = False) -> str:
        """Return what to do; the faults of a simulated arm have other remedies."""
        return remedy_of(self.do, simulated=simulated) if isinstance(self.do, FaultCode) else self.do


# The sentences of the other alerts themselves say what to do.
ADVICE: Mapping[ServoAlert, Advice] = {
    ServoAlert.VOLTAGE: Advice(
        "the supply is outside the limits in registers MIN_VOLTAGE and MAX_VOLTAGE",
        "Compare the supply with the servo's variant: one of 7.4 V on 12 V must be switched off at once.",
    ),
    ServoAlert.ENCODER: Advice("the servo cannot read its own position", FaultCode.ENCODER_ERROR),
    ServoAlert.TEMPERATURE: Advice("the motor is hotter than register MAX_TEMPERATURE allows", FaultCode.OVERHEATED),
    ServoAlert.CURRENT: Advice("the motor drew more than register PROTECTION_CURRENT allows", FaultCode.OVERCURRENT),
    ServoAlert.ANGLE: Advice(
        "the joint stands outside the servo's angle limits",
        "Relax the arm, bring the joint inside its range by hand, and compare the limits with the calibration.",
    ),
    ServoAlert.OVERLOAD: Advice(
        "the load was too high for too long, and the servo has cut its own torque", FaultCode.OVERLOAD
    ),
    ServoAlert.SERVO_REBOOTED: Advice("the servo lost its supply for a moment and restarted", FaultCode.SERVO_REBOOTED),
    ServoAlert.TORQUE_LOST: Advice("the servo was found without torque while it should hold", FaultCode.TORQUE_LOST),
    ServoAlert.SILENT_CYCLES: Advice(
        "replies were lost or garbled; one in a hundred is too many",
        "Replace cables and plugs one by one, and keep them away from the supply's leads.",
    ),
    ServoAlert.NO_ANSWER: Advice("the servo does not answer", FaultCode.SERVO_SILENT),
    ServoAlert.WARM: Advice(
        "the motor is warmer than arm.warn_temperature_c",
        "Relax the arm when it is idle, do not hold it stretched out, and grip with less force.",
    ),
    ServoAlert.SLOWED: Advice(
        "the motor is hotter than arm.slow_temperature_c, so motions run at half speed",
        "Let the servo cool below 55 degrees: relax the arm, and grip or carry less.",
    ),
    ServoAlert.ANGLE_LIMITS: Advice(
        "the limits in the servo are of another calibration",
        "Name the calibration that the servos hold, or calibrate again: armbridge calibrate NAME --write-servos.",
    ),
    ServoAlert.SEVERAL_TURNS: Advice(
        "the position goes on beyond one turn, and overflows",
        "Clear bit 4 (value 16) of register 18 (PHASE) with Feetech's FD program, or connect lerobot once: it does.",
    ),
    ServoAlert.MODEL: Advice(
        "the servo is another one than robot.toml names",
        "Correct the model in robot.toml if the arm was built so; else replace the servo.",
    ),
    ServoAlert.FIRMWARE: Advice(
        "its registers may act differently from the registers of the other servos",
        "Bring all servos to the same version with Feetech's FD program.",
    ),
    ServoAlert.REGISTER: Advice(
        "a setting of the servo differs from the factory's and from the arm's profile",
        "If it is meant so, name it in robot.toml ([hardware.profile]); else write the profile's value with armbridge "
        "setup --registers.",
    ),
}


def advise(alerts: Iterable[ServoAlert], *, simulated: bool = False) -> list[str]:
    """Return the advice on alerts, each once: its name, its meaning and what to do; none on an alert without advice."""
    return [
        f"{alert.value}: {ADVICE[alert].means}. {ADVICE[alert].remedy(simulated=simulated)}"
        for alert in dict.fromkeys(alerts)
        if alert in ADVICE
    ]
