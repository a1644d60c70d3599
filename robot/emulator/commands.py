"""What each live command does, and which values it takes; ``robot.emulator.control`` lists them for people."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from robot.emulator.faults import PROBABILITIES
from robot.emulator.servo import Servo
from robot.emulator.servo_bus import ServoBus
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag

MAX_TICKS = 4095

# The motor's whole duty.
MAX_PUSH_PERMILLE = 1000

# What a byte of register PRESENT_TEMPERATURE and one of PRESENT_VOLTAGE hold.
MAX_TEMPERATURE_C = 255
MAX_VOLTAGE_V = 25.5

MAX_STATUS = 255

# Longer than anything waits for a reply.
MAX_DELAY_S = 10.0

# FTDI's adapters hold bytes back for 16 ms.
MAX_USB_FRAME_MS = 100

# An hour of holding in a second.
MAX_HEAT_RATE = 3600


class Adapter(Protocol):
    """The USB adapter, as commands change it.

    Attributes:
        port: the port's own name.
        frozen: whether it neither takes nor gives bytes.
        frame_s: replies are handed on at multiples of this time [s]; 0 hands them on at once.
    """

    port: str
    frozen: bool
    frame_s: float

    def plug_in(self, *, renamed: bool = False) -> None:
        """Offer the port, under another name if ``renamed``; one that is there already stays."""

    def unplug(self) -> None:
        """Take the port away."""


@dataclass(frozen=True)
class Emulation:
    """All that commands can change."""

    bus: ServoBus
    adapter: Adapter


@dataclass(frozen=True)
class Number:
    """A number for the whole emulation.

    Attributes:
        lowest: least that makes sense.
        highest: most.
        put: what to do with it.
        meaning: what it is.
    """

    lowest: float
    highest: float
    put: Callable[[Emulation, float], None]
    meaning: str = "a number"


@dataclass(frozen=True)
class Value:
    """A number for one servo.

    Attributes:
        lowest: least that makes sense.
        highest: most.
        put: what to do with it.
        end: what null does, where that makes sense.
    """

    lowest: float
    highest: float
    put: Callable[[Servo, float], None]
    end: Callable[[Servo], None] | None = None


def _probability(name: str) -> Number:
    return Number(0.0, 1.0, lambda emulation, value: setattr(emulation.bus.faults, name, value), "a probability")


def _supply(emulation: Emulation, voltage_v: float) -> None:
    for servo in emulation.bus.servos:
        servo.voltage_v = voltage_v


def _heat_rate(emulation: Emulation, rate: float) -> None:
    for servo in emulation.bus.servos:
        servo.motor.rate = rate


def _delay(emulation: Emulation, delay_s: float) -> None:
    emulation.bus.faults.delay_s = delay_s


def _usb_frame(emulation: Emulation, frame_ms: float) -> None:
    emulation.adapter.frame_s = frame_ms / 1000.0


NUMBERS: Mapping[str, Number] = MappingProxyType(
    {
        **{name: _probability(name) for name in PROBABILITIES},
        "delay_s": Number(0.0, MAX_DELAY_S, _delay),
        "supply": Number(0.0, MAX_VOLTAGE_V, _supply),
        "heat_rate": Number(0.0, MAX_HEAT_RATE, _heat_rate),
        "usb_frame_ms": Number(0.0, MAX_USB_FRAME_MS, _usb_frame),
    }
)


def _torque_off(_emulation: Emulation, servo: Servo) -> None:
    servo.write(Register.TORQUE_ENABLE, bytes([0]))


def _powers_up_holding(_emulation: Emulation, servo: Servo) -> None:
    servo.powers_up_holding = True


def _overload_latches(_emulation: Emulation, servo: Servo) -> None:
    servo.protection.latches = True


FOR_SERVOS: Mapping[str, Callable[[Emulation, Servo], None]] = MappingProxyType(
    {
        "offline": lambda emulation, servo: emulation.bus.faults.offline.add(servo.servo_id),
        "online": lambda emulation, servo: emulation.bus.faults.offline.discard(servo.servo_id),
        "power_cycle": lambda _emulation, servo: servo.power_up(),
        "torque_off": _torque_off,
        "powers_up_holding": _powers_up_holding,
        "overload_latches": _overload_latches,
    }
)


def _obstacle(servo: Servo, ticks: float) -> None:
    servo.plant.block(ticks + servo.value(Register.HOMING_OFFSET))


def _push(servo: Servo, push_permille: float) -> None:
    servo.plant.push_permille = push_permille


def _hand(servo: Servo, ticks: float) -> None:
    servo.plant.hand_ticks = ticks + servo.value(Register.HOMING_OFFSET)


def _let_go(servo: Servo) -> None:
    servo.plant.hand_ticks = None


def _jump(servo: Servo, ticks: float) -> None:
    servo.plant.position_ticks += ticks


def _temperature(servo: Servo, temperature_c: float) -> None:
    servo.motor.temperature_c = temperature_c


def _voltage(servo: Servo, voltage_v: float) -> None:
    servo.voltage_v = voltage_v


def _status(servo: Servo, status: float) -> None:
    servo.protection.forced = StatusFlag(int(status))


VALUES: Mapping[str, Value] = MappingProxyType(
    {
        "obstacle": Value(0, MAX_TICKS, _obstacle, lambda servo: servo.plant.block(None)),
        "push": Value(-MAX_PUSH_PERMILLE, MAX_PUSH_PERMILLE, _push),
        "hand": Value(0, MAX_TICKS, _hand, _let_go),
        "jump": Value(-MAX_TICKS, MAX_TICKS, _jump),
        "temperature": Value(0, MAX_TEMPERATURE_C, _temperature),
        "voltage": Value(0, MAX_VOLTAGE_V, _voltage),
        "status": Value(0, MAX_STATUS, _status),
    }
)


def _stall_behind_missing(emulation: Emulation, on: bool) -> None:
    emulation.bus.faults.stall_behind_missing = on


def _frozen(emulation: Emulation, on: bool) -> None:
    emulation.adapter.frozen = on


SWITCHES: Mapping[str, Callable[[Emulation, bool], None]] = MappingProxyType(
    {"stall_behind_missing": _stall_behind_missing, "frozen": _frozen}
)
