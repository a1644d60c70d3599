"""Faults of a running arm: code, message and remedy of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


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
        """Advice to the person at the arm, one sentence."""
        return remedy_of(self.code, simulated=self.simulated)

    def __str__(self) -> str:
        return f"{self.message}. {self.remedy}"
