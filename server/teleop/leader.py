"""Samples of a leader: put in order of time, freed of a network's jitter, and checked for gaps and jumps."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from server.execution.motions import Positions

# Half a second at 100 Hz; at a higher rate the oldest are dropped.
MAX_SAMPLES = 50

# A following that is later than this is felt by the hand that leads.
MAX_DELAY_S = 0.1

# Time over which velocities are taken: one tick of an encoder between two readings at 100 Hz is 0.15 rad/s [s].
VELOCITY_TIME_S = 0.05

# A sample that is older than this was not overtaken by the one before: the leader's clock was set back [s].
SET_BACK_S = 1.0

# Lateness is forgotten after this time, so that one late sample does not delay the following for ever.
REMEMBERED_S = 2.0

# A smaller step is taken for noise of an encoder or for a sample that was lost, however fast it would be.
JUMP_RAD = 0.25

# A hand may lead faster than the follower can go, which then comes behind; faster than this it is no hand.
JUMP_SPEEDS = 2.0


@dataclass(frozen=True)
class LeaderSample:
    """Reading of a leader."""

    stamp_s: float
    positions_rad: Positions


@dataclass(frozen=True)
class LeaderPose:
    """Pose of a leader to be followed.

    Attributes:
        latency_s: time since the reading, without the least time that a sample has taken to come [s].
    """

    positions_rad: Positions
    velocity_rad_s: Positions
    latency_s: float


class JitterBuffer:
    """Samples of the last moments, with the delay that their jitter asks for.

    The clock of a leader elsewhere has any offset to this one; the offset is taken from the samples that came fastest.

    Args:
        max_velocity_rad_s: greatest velocity of each joint that is watched for jumps [rad/s].
        max_delay_s: greatest delay; 0 to follow the latest sample, as of an arm of this server [s].
    """

    def __init__(self, max_velocity_rad_s: Mapping[str, float], max_delay_s: float = MAX_DELAY_S) -> None:
        self._max_delay_s = max_delay_s
        self._max_velocity_rad_s = max_velocity_rad_s
        self._samples: deque[LeaderSample] = deque(maxlen=MAX_SAMPLES)
        # Arrival and transit of each sample: time of its arrival less its stamp [s].
        self._transits: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES * 4)
        self._arrived_s = -math.inf
        self._jump = ""

    def add(self, sample: LeaderSample, now_s: float) -> None:
        """Take a sample; an older one than the last is dropped, unless the leader's clock was set back."""
        last = self._samples[-1] if self._samples else None
        if last is not None:
            if last.stamp_s - SET_BACK_S < sample.stamp_s <= last.stamp_s:
                return
            self._jump = self._jump or self._jump_between(last, sample)
            if sample.stamp_s <= last.stamp_s:
                self._samples.clear()
                self._transits.clear()
        self._samples.append(sample)
        self._transits.append((now_s, now_s - sample.stamp_s))
        while self._transits[0][0] < now_s - REMEMBERED_S:
            self._transits.popleft()
        self._arrived_s = now_s

    def age_s(self, now_s: float) -> float:
        """Return the time since the last sample came [s]; infinite before the first."""
        return now_s - self._arrived_s

    @property
    def at_once(self) -> bool:
        """True where each sample is to be followed as soon as it comes."""
        return self._max_delay_s == 0.0

    @property
    def delay_s(self) -> float:
        """Delay that evens the jitter out [s]."""
        if not self._transits:
            return 0.0
        transits = [transit for _, transit in self._transits]
        return min(max(transits) - min(transits), self._max_delay_s)

    def take_jump(self) -> str:
        """Return in words how the leader has jumped since the last call; empty if it has not."""
        jump, self._jump = self._jump, ""
        return jump

    def clear(self) -> None:
        """Forget all samples: what comes next is no continuation."""
        self._samples.clear()
        self._transits.clear()
        self._arrived_s, self._jump = -math.inf, ""

    def pose(self, now_s: float) -> LeaderPose | None:
        """Return the pose to follow now, between two samples where there are two; None without a sample.

        Beyond the last sample the leader is taken to rest: it is not extrapolated.
        """
        if not self._samples:
            return None
        fastest_s = min(transit for _, transit in self._transits)
        shown_s = now_s - fastest_s - self.delay_s
        later = self._samples[-1]
        if shown_s >= later.stamp_s:
            return LeaderPose(
                later.positions_rad, self._latest_velocity(shown_s), max(now_s - fastest_s - later.stamp_s, 0.0)
            )
        for earlier in list(self._samples)[-2::-1]:
            if earlier.stamp_s <= shown_s:
                passed_s, slope = shown_s - earlier.stamp_s, _velocity(earlier, later)
                positions = {name: earlier.positions_rad[name] + passed_s * slope[name] for name in slope}
                return LeaderPose(positions, self._velocity_until(later), self.delay_s)
            later = earlier
        return LeaderPose(later.positions_rad, dict.fromkeys(later.positions_rad, 0.0), self.delay_s)

    def _latest_velocity(self, shown_s: float) -> dict[str, float]:
        """Return the velocity at the last sample, zero once the next one is overdue."""
        last = self._samples[-1]
        if len(self._samples) > 1 and shown_s - last.stamp_s > 2.0 * (last.stamp_s - self._samples[-2].stamp_s):
            return dict.fromkeys(last.positions_rad, 0.0)
        return self._velocity_until(last)

    def _velocity_until(self, last: LeaderSample) -> dict[str, float]:
        """Return the velocity in the time before a sample; zero for the first."""
        before = next(
            (each for each in reversed(self._samples) if last.stamp_s - each.stamp_s >= VELOCITY_TIME_S), None
        )
        before = before or self._samples[0]
        return dict.fromkeys(last.positions_rad, 0.0) if before is last else _velocity(before, last)

    def _jump_between(self, before: LeaderSample, after: LeaderSample) -> str:
        span_s = after.stamp_s - before.stamp_s
        for name, limit_rad_s in self._max_velocity_rad_s.items():
            if name not in before.positions_rad or name not in after.positions_rad:
                continue
            step_rad = abs(after.positions_rad[name] - before.positions_rad[name])
            if step_rad > max(JUMP_RAD, JUMP_SPEEDS * limit_rad_s * span_s):
                return f"{name} of the leader jumped by {step_rad:.2f} rad within {span_s:.3f} s"
        return ""


def _velocity(before: LeaderSample, after: LeaderSample) -> dict[str, float]:
    span_s = after.stamp_s - before.stamp_s
    return {
        name: (position - before.positions_rad[name]) / span_s
        for name, position in after.positions_rad.items()
        if name in before.positions_rad
    }
