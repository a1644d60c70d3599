"""Shorten a curve in time: replace random parts of it by least-time ramps where those are free."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from planners.motions.curve import Curve
from planners.motions.ramps import connect, least_time_s, reduced, whole_ticks
from planners.rates import RateLimits

Vector = NDArray[np.float64]

# Parts drawn at once: the time that each would save costs next to nothing in one numpy call, and the one that saves
# most is tried first.
PARTS_A_ROUND = 32

# Of them so many are tried before others are drawn: those that save less are less worth a check.
TRIES_A_ROUND = 2

# What is free gets shorter and shorter parts: by this factor after a round without a gain, and back after one with.
SHRINK = 0.7

# A part that saves less does not pay for its checks [ticks].
LEAST_GAIN_TICKS = 40

# After so many rounds without a gain the curve is about as short as it gets.
FRUITLESS_ROUNDS = 8


def smooth(
    curve: Curve,
    limits: RateLimits,
    free: Callable[[Curve], bool],
    rng: np.random.Generator,
    should_stop: Callable[[], bool],
) -> Curve:
    """Shorten a curve in time.

    Args:
        curve: free, and within the limits.
        limits: what to keep; their jerk is not considered.
        free: whether a piece may be driven.
        rng: what draws the parts.
        should_stop: asked before each try.

    Returns:
        A curve with the same end states that takes no longer.
    """
    fruitless, reach = 0, 1.0
    while fruitless < FRUITLESS_ROUNDS and not should_stop():
        shorter = next(_shorter(curve, reach, limits, free, rng), None)
        fruitless, reach = (fruitless + 1, SHRINK * reach) if shorter is None else (0, min(1.0, reach / SHRINK))
        curve = shorter or curve
    return curve


def _shorter(
    curve: Curve, reach: float, limits: RateLimits, free: Callable[[Curve], bool], rng: np.random.Generator
) -> Iterator[Curve]:
    """Curves with one part of at most a share ``reach`` of the whole replaced."""
    for first, last, ticks in _parts(curve, reach, limits, rng):
        positions, velocities, _ = curve.at(np.array([first, last]))
        piece = connect(positions[0], velocities[0], positions[1], velocities[1], ticks, limits)
        if piece is not None and free(piece):
            yield curve.replaced(first, last, piece)


def _parts(curve: Curve, reach: float, limits: RateLimits, rng: np.random.Generator) -> Iterator[tuple[int, int, int]]:
    """Parts of the curve, first and last tick, that ramps of so many ticks could replace; the best first."""
    middles = rng.uniform(0.0, 1.0, PARTS_A_ROUND)
    lengths = reach * rng.uniform(0.0, 1.0, PARTS_A_ROUND)
    shares = np.clip((middles - 0.5 * lengths, middles + 0.5 * lengths), 0.0, 1.0)
    ends = np.rint(shares * curve.duration_ticks).astype(np.int64)
    positions, velocities, _ = curve.at(ends.ravel())
    p0, p1 = positions[:PARTS_A_ROUND], positions[PARTS_A_ROUND:]
    v0, v1 = velocities[:PARTS_A_ROUND], velocities[PARTS_A_ROUND:]
    ticks = whole_ticks(least_time_s(p0, v0, p1, v1, reduced(limits)))
    gains = ends[1] - ends[0] - ticks
    for i in np.argsort(-gains, kind="stable")[:TRIES_A_ROUND]:
        if gains[i] >= LEAST_GAIN_TICKS:
            yield int(ends[0, i]), int(ends[1, i]), int(ticks[i])
