"""Limits that the agent cannot change: speed, and the region in which the tip may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# Poses of the tip that are computed along a path.
PATH_SAMPLES = 20


class LimitError(ValueError):
    """A request beyond a limit; the sentence names field, limit and value."""


@dataclass(frozen=True)
class Region:
    """Box in the planning frame [m].

    Attributes:
        lower: least x, y and z.
        upper: greatest x, y and z.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    @classmethod
    def parse(cls, text: str) -> Region:
        """Return the region of ``x,y,z,x,y,z``: least values first.

        Raises:
            ValueError: it is no region.
        """
        values = tuple(float(each) for each in text.split(","))
        if len(values) != 6 or not all(low < high for low, high in zip(values[:3], values[3:])):
            raise ValueError(f"a region has six numbers, least x,y,z and greatest x,y,z, not {text!r}")
        return cls(values[:3], values[3:])

    def check(self, point: Sequence[float], subject: str) -> None:
        """Check a position of the tip [m].

        Raises:
            LimitError: the position is outside.
        """
        for axis, value, low, high in zip("xyz", point, self.lower, self.upper):
            if not low <= value <= high:
                raise LimitError(f"{subject} has {axis} = {value:.3f} m, the limits are {low:g} to {high:g}: {self}")

    def __str__(self) -> str:
        pairs = zip("xyz", self.lower, self.upper)
        return ", ".join(f"{axis} {low:g} to {high:g} m" for axis, low, high in pairs)


def limited_speed(speed: float, limit: float) -> float:
    """Return the share of the joints' velocity limits for a motion.

    Args:
        speed: requested share; 0 for the limit.

    Raises:
        LimitError: it is no share, or above the limit.
    """
    if speed == 0.0:
        return limit
    if not 0.0 < speed <= limit:
        raise LimitError(f"speed must be above 0 and at most {limit:g}, not {speed:g}; leave it out for {limit:g}")
    return speed


def samples(count: int) -> list[int]:
    """Return the indices of a path's points at which the region is checked, the last one included."""
    if count <= PATH_SAMPLES:
        return list(range(count))
    return sorted({round(number * (count - 1) / (PATH_SAMPLES - 1)) for number in range(PATH_SAMPLES)})
