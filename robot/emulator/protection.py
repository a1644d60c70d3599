"""What a servo does to protect itself: the status bits, and how much torque they leave. Pure; time is passed in."""

from __future__ import annotations

from dataclasses import dataclass

from robot.hardware.interface import StatusFlag

# Register 38's factory value; what the register says is not followed.
OVERCURRENT_TIME_S = 2.0

FULL_DUTY_PERMILLE = 1000.0


@dataclass(frozen=True)
class Thresholds:
    """What the EPROM says of protection.

    Attributes:
        voltage_v: lowest and highest supply [V].
        temperature_c: highest [degC].
        overload_permille: duty from which the overload timer runs [0.1 %].
        overload_s: how long it may [s].
        protective_permille: duty left after an overload [0.1 %].
        current_a: greatest [A].
        unloading: complaints that take torque away.
    """

    voltage_v: tuple[float, float]
    temperature_c: float
    overload_permille: float
    overload_s: float
    protective_permille: float
    current_a: float
    unloading: StatusFlag


@dataclass(frozen=True)
class Measured:
    """What the servo measures of itself.

    Attributes:
        duty_permille: what the motor gives, signed [0.1 %].
        current_a: signed [A].
        temperature_c: [degC].
        voltage_v: [V].
    """

    duty_permille: float
    current_a: float
    temperature_c: float
    voltage_v: float


class Protection:
    """Timers and latches of one servo.

    Overload and overcurrent stay until torque is switched off, or until power is if ``latches``; the rest last as
    long as their cause.

    Attributes:
        latches: whether switching torque off does not clear an overload.
        forced: complaints made from outside, in force until taken back.
        status: the complaints, as in register STATUS.
    """

    def __init__(self) -> None:
        self.latches = False
        self.forced = self.status = self._latched = StatusFlag(0)
        self._overload_s = self._overcurrent_s = 0.0

    def step(self, duration_s: float, measured: Measured, limits: Thresholds) -> None:
        """Let time pass [s] under what is measured at its end."""
        overloaded = abs(measured.duty_permille) >= limits.overload_permille
        self._overload_s = self._overload_s + duration_s if overloaded else 0.0
        self._overcurrent_s = self._overcurrent_s + duration_s if abs(measured.current_a) > limits.current_a else 0.0
        if self._overload_s > limits.overload_s:
            self._latched |= StatusFlag.OVERLOAD
        if self._overcurrent_s > OVERCURRENT_TIME_S:
            self._latched |= StatusFlag.CURRENT
        self.status = self._latched | self.forced
        if not limits.voltage_v[0] <= measured.voltage_v <= limits.voltage_v[1]:
            self.status |= StatusFlag.VOLTAGE
        if measured.temperature_c > limits.temperature_c:
            self.status |= StatusFlag.TEMPERATURE

    def duty_left_permille(self, limits: Thresholds) -> float:
        """Largest duty that the complaints leave [0.1 %]."""
        effective = self.status & limits.unloading
        if effective & ~StatusFlag.OVERLOAD:
            return 0.0
        return limits.protective_permille if effective else FULL_DUTY_PERMILLE

    def torque_off(self) -> None:
        """Torque was switched off: what that clears is cleared."""
        if not self.latches:
            self.power_up()

    def power_up(self) -> None:
        """Power came on: nothing is remembered."""
        self._overload_s = self._overcurrent_s = 0.0
        self.status &= ~self._latched | self.forced
        self._latched = StatusFlag(0)
