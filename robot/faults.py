"""Faults of a running arm and alerts of its servos: code, meaning and remedy of each."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple


class FaultCode(Enum):
    """Names of the faults, as clients see them."""

    BUS_LOST = "bus_lost"
    SERVO_SILENT = "servo_silent"
    BUS_SILENT = "bus_silent"
    TRACKING_LOST = "tracking_lost"
    STALLED = "stalled"
    OVERLOAD = "overload"
    OVERCURRENT = "overcurrent"
    OVERHEATED = "overheated"
    VOLTAGE_LOW = "voltage_low"
    VOLTAGE_HIGH = "voltage_high"
    ENCODER_ERROR = "encoder_error"
    POSITION_JUMP = "position_jump"
    TORQUE_LOST = "torque_lost"
    SERVO_REBOOTED = "servo_rebooted"
    STARTUP_REFUSED = "startup_refused"
    EMERGENCY_STOP = "emergency_stop"
    EMERGENCY_STOP_UNVERIFIED = "emergency_stop_unverified"
    PROCESS_LOST = "process_lost"


# Advice to a person at the arm, one sentence each.
REMEDIES: Mapping[FaultCode, str] = {
    FaultCode.BUS_LOST: "Check the USB cable and the servo adapter's supply; the server reconnects by itself.",
    FaultCode.SERVO_SILENT: "Check the cable to this servo and the one before it, then reset the fault.",
    FaultCode.BUS_SILENT: (
        "Check the adapter, its USB cable and the servos' supply, and whether this machine is overloaded, "
        "then reset the fault."
    ),
    FaultCode.TRACKING_LOST: "Clear what blocks the arm or lower speed and payload, then reset the fault.",
    FaultCode.STALLED: "Clear what blocks the joint, then reset the fault.",
    FaultCode.OVERLOAD: "Relieve the joint, then reset the fault; if it stays, switch the servos' supply off and on.",
    FaultCode.OVERCURRENT: "Relieve the joint and check it for a jammed gear, then reset the fault.",
    FaultCode.OVERHEATED: "The arm is relaxed: let the servo cool below 55 degrees, then reset the fault.",
    FaultCode.VOLTAGE_LOW: "Check the supply and its plugs: it must give 5 V or more, with 4 A or more.",
    FaultCode.VOLTAGE_HIGH: "Check the supply: a 7.4 V servo on 12 V is damaged by it.",
    FaultCode.ENCODER_ERROR: "Switch the servos' supply off and on; replace the servo if it comes back.",
    FaultCode.POSITION_JUMP: "Check the joint's gear and horn screw, and its calibration, then reset the fault.",
    FaultCode.TORQUE_LOST: "Something else switched torque off, or the supply broke down; reset the fault.",
    FaultCode.SERVO_REBOOTED: "Check the supply and the cables for loose contacts, then reset the fault.",
    FaultCode.STARTUP_REFUSED: "Do what the message says, then reset the fault.",
    FaultCode.EMERGENCY_STOP: "Make sure that the arm may move, then reset the fault and enable it.",
    FaultCode.EMERGENCY_STOP_UNVERIFIED: "Cut the servos' supply: some may still be driven.",
    FaultCode.PROCESS_LOST: "The arm process restarts; reset the fault when it is back.",
}


# For a simulated arm, which has no cable, supply or gear; faults of its servos come from live commands.
SIMULATED_REMEDIES: Mapping[FaultCode, str] = {
    FaultCode.BUS_LOST: "The emulated adapter is unplugged; the server reconnects once it is plugged in again.",
    FaultCode.SERVO_SILENT: "The emulated servo is offline: bring it online, then reset the fault.",
    FaultCode.BUS_SILENT: "The emulated bus is frozen or its servos are offline: undo that, then reset the fault.",
    FaultCode.OVERLOAD: "Relieve the joint, then reset the fault; if it stays, power-cycle the emulated servo.",
    FaultCode.OVERCURRENT: "Relieve the joint, then reset the fault.",
    FaultCode.VOLTAGE_LOW: "Raise the emulated supply, then reset the fault.",
    FaultCode.VOLTAGE_HIGH: "Lower the emulated supply, then reset the fault.",
    FaultCode.ENCODER_ERROR: "Take the forced complaint back, then reset the fault.",
    FaultCode.POSITION_JUMP: "The emulated joint was made to jump; reset the fault.",
    FaultCode.TORQUE_LOST: "Torque was switched off from outside; reset the fault.",
    FaultCode.SERVO_REBOOTED: "The emulated servo was power-cycled; reset the fault.",
    FaultCode.EMERGENCY_STOP_UNVERIFIED: "Some emulated servos do not answer: bring them online, then reset the fault.",
}


def remedy_of(code: FaultCode, *, simulated: bool) -> str:
    """Return the advice on a fault to the person at the arm, one sentence."""
    return SIMULATED_REMEDIES.get(code, REMEDIES[code]) if simulated else REMEDIES[code]


@dataclass(frozen=True)
class Fault:
    """Fault, latched until it is reset."""

    code: FaultCode
    message: str  # one sentence with joint and figures
    joint: str = ""  # joint concerned; empty for the whole arm
    stamp_s: float = 0.0  # wall-clock time at which it was detected [s since the epoch]
    simulated: bool = False  # True for a simulated arm, whose remedies differ

    @property
    def remedy(self) -> str:
        return remedy_of(self.code, simulated=self.simulated)

    def __str__(self) -> str:
        return f"{self.message}. {self.remedy}"


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
        "With the arm relaxed, bring the joint inside its range by hand, and compare the limits with the calibration.",
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
        "Keep the arm relaxed while it is idle, do not hold it stretched out, and grip with less force.",
    ),
    ServoAlert.SLOWED: Advice(
        "the motor is hotter than arm.slow_temperature_c, so motions run at half speed",
        "Let the servo cool below 55 degrees, with the arm relaxed; then grip or carry less.",
    ),
    ServoAlert.ANGLE_LIMITS: Advice(
        "the limits in the servo are of another calibration",
        "Name the calibration that the servos hold, or calibrate again: armbridge calibrate NAME --write-servos.",
    ),
    ServoAlert.SEVERAL_TURNS: Advice(
        "the position goes on beyond one turn, and overflows",
        "Clear bit 4 of register PHASE: armbridge setup --registers does, and so does lerobot when it connects.",
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
