"""Complaints about a servo: the meaning of each, and what to do about it.

A complaint is a status flag, an event that was counted, or a warning. Where a fault belongs to it, the remedy is that
of the fault (:mod:`robot.faults`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from robot.faults import FaultCode, remedy_of


class Complaint(Enum):
    """Complaints; status flags and counted errors have the names by which ``/diagnostics`` counts them."""

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
    SEVERAL_TURNS = "several_turns"
    MODEL = "model"
    FIRMWARE = "firmware"
    REGISTER = "register"


@dataclass(frozen=True)
class Advice:
    """Advice on a complaint.

    Attributes:
        means: meaning of the complaint, without a full stop.
        do: what to do, one or two sentences; for a code, the remedy of that fault.
    """

    means: str
    do: str | FaultCode

    def remedy(self, *, simulated: bool = False) -> str:
        """Return what to do.

        Args:
            simulated: True for a simulated arm, whose faults have other remedies.
        """
        return remedy_of(self.do, simulated=simulated) if isinstance(self.do, FaultCode) else self.do


ADVICE: Mapping[Complaint, Advice] = {
    Complaint.VOLTAGE: Advice(
        "the supply is outside the limits in registers MIN_VOLTAGE and MAX_VOLTAGE",
        "Compare the supply with the servo's variant: one of 7.4 V on 12 V must be switched off at once.",
    ),
    Complaint.ENCODER: Advice("the servo cannot read its own position", FaultCode.ENCODER_ERROR),
    Complaint.TEMPERATURE: Advice("the motor is hotter than register MAX_TEMPERATURE allows", FaultCode.OVERHEATED),
    Complaint.CURRENT: Advice("the motor drew more than register PROTECTION_CURRENT allows", FaultCode.OVERCURRENT),
    Complaint.ANGLE: Advice(
        "the joint stands outside the servo's angle limits",
        "Relax the arm, bring the joint inside its range by hand, and compare the limits with the calibration.",
    ),
    Complaint.OVERLOAD: Advice(
        "the load was too high for too long, and the servo has cut its own torque", FaultCode.OVERLOAD
    ),
    Complaint.SERVO_REBOOTED: Advice(
        "the servo lost its supply for a moment and started anew", FaultCode.SERVO_REBOOTED
    ),
    Complaint.TORQUE_LOST: Advice("the servo was found without torque while it should hold", FaultCode.TORQUE_LOST),
    Complaint.SILENT_CYCLES: Advice(
        "replies were lost or garbled; one in a hundred is too many",
        "Replace cables and plugs one by one, and keep them away from the supply's leads.",
    ),
    Complaint.NO_ANSWER: Advice("the servo does not answer", FaultCode.SERVO_SILENT),
    Complaint.WARM: Advice(
        "the motor is warmer than arm.warn_temperature_c",
        "Relax the arm when it is idle, do not hold it stretched out, and grip with less force.",
    ),
    Complaint.SLOWED: Advice(
        "the motor is hotter than arm.slow_temperature_c, so motions run at half speed",
        "Let the servo cool below 55 degrees: relax the arm, and grip or carry less.",
    ),
    Complaint.ANGLE_LIMITS: Advice(
        "the limits in the servo are of another calibration",
        "Name the calibration that the servos hold, or calibrate anew: armbridge calibrate NAME --write-servos.",
    ),
    Complaint.SEVERAL_TURNS: Advice(
        "the position goes on beyond one turn, and overflows",
        "Clear bit 4 (value 16) of register 18 (PHASE) with Feetech's FD program, or connect lerobot once: it does.",
    ),
    Complaint.MODEL: Advice(
        "the servo is another one than robot.toml names",
        "Correct the model in robot.toml if the arm was built so; else replace the servo.",
    ),
    Complaint.FIRMWARE: Advice(
        "its registers may act differently from those of the other servos",
        "Bring all servos to the same version with Feetech's FD program.",
    ),
    Complaint.REGISTER: Advice(
        "a setting of the servo is neither the factory's nor that of the arm's profile",
        "If it is meant so, name it in robot.toml ([hardware.profile]); else write the profile's value with armbridge "
        "setup --registers.",
    ),
}

# Sentences of warnings, by what they have in common.
_WARNINGS: tuple[tuple[re.Pattern[str], Complaint], ...] = (
    *(
        (re.compile(rf"complains of .*\b{complaint.value}\b"), complaint)
        for complaint in (
            Complaint.VOLTAGE,
            Complaint.ENCODER,
            Complaint.TEMPERATURE,
            Complaint.CURRENT,
            Complaint.ANGLE,
            Complaint.OVERLOAD,
        )
    ),
    (re.compile(r"^no answer for|has not answered yet"), Complaint.NO_ANSWER),
    (re.compile(r"^warm: "), Complaint.WARM),
    (re.compile(r"^motions run at half speed"), Complaint.SLOWED),
    (re.compile(r"angle limits .* differ from the calibrated range"), Complaint.ANGLE_LIMITS),
    (re.compile(r"counts several turns"), Complaint.SEVERAL_TURNS),
    (re.compile(r"^the servo is model .*, not "), Complaint.MODEL),
    (re.compile(r"^the servo has firmware "), Complaint.FIRMWARE),
    (re.compile(r"^register \w+ is .* as in the profile "), Complaint.REGISTER),
)


def complaints_in(warnings: Iterable[str]) -> list[Complaint]:
    """Return the complaints that warnings are about; a warning that says itself what to do is about none."""
    return [complaint for warning in warnings for pattern, complaint in _WARNINGS if pattern.search(warning)]


def advise(complaints: Iterable[Complaint], *, simulated: bool = False) -> list[str]:
    """Return the advice on complaints, each once: its name, its meaning and what to do.

    Args:
        complaints: complaints, which may repeat.
        simulated: True for a simulated arm.
    """
    return [
        f"{complaint.value}: {ADVICE[complaint].means}. {ADVICE[complaint].remedy(simulated=simulated)}"
        for complaint in dict.fromkeys(complaints)
    ]
