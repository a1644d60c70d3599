"""The temperature of a servo's motor. Pure; time is passed in."""

from __future__ import annotations

from dataclasses import dataclass

AMBIENT_C = 32.0

# A held stretched arm (0.2 A) grows warm, a stalled motor (2.4 A) gains half a degree each second.
KELVIN_PER_A2 = 60.0

# A motor in its plastic housing takes ten minutes to most of its temperature.
TIME_CONSTANT_S = 600.0


@dataclass
class Motor:
    """The motor as a body that is warmed by its current and cooled by the air.

    Attributes:
        temperature_c: of the housing [degC].
        rate: how much faster than life it warms and cools.
    """

    temperature_c: float = AMBIENT_C
    rate: float = 1.0

    def step(self, duration_s: float, current_a: float) -> None:
        """Let time pass [s]."""
        target_c = AMBIENT_C + KELVIN_PER_A2 * current_a * current_a
        share = min(1.0, duration_s * self.rate / TIME_CONSTANT_S)
        self.temperature_c += (target_c - self.temperature_c) * share
