"""Targets of policies: blending, and motions within limits that follow them."""

import numpy as np
import pytest

from robot.trajectory import MotionLimits, Trajectory, Vector
from server.chunks.targets import Blend, Targets, blended, deviation_rad, follow

NAMES = ("a", "b")
ACCELERATION = np.array([6.0, 10.0])
LIMITS = MotionLimits(np.array([2.0, 2.5]), ACCELERATION, ACCELERATION / 0.02)
BEGINS_S = 10.0
TICK_S = 0.01


def wave(hz: float = 30.0, count: int = 50, rate: float = 1.0) -> Targets:
    time_s = BEGINS_S + np.arange(count) / hz
    phase = rate * (time_s - BEGINS_S)
    return Targets(NAMES, time_s, np.stack((0.4 * np.sin(phase), 0.3 - 0.3 * np.cos(phase)), axis=-1))


def at_rest(position_rad: Vector) -> tuple[Vector, Vector, Vector]:
    return position_rad, np.zeros(len(position_rad)), np.zeros(len(position_rad))


def setpoints(motion: Trajectory) -> Vector:
    ticks = np.arange(0.0, motion.duration_s + TICK_S, TICK_S)
    return np.array([motion.sample(float(each))[0] for each in ticks])


def assert_within_limits(motion: Trajectory) -> None:
    for order, limit in ((1, LIMITS.velocity), (2, LIMITS.acceleration), (3, LIMITS.jerk)):
        assert (np.abs(np.diff(setpoints(motion), order, axis=0)) / TICK_S**order <= 1.001 * limit).all()


@pytest.mark.parametrize("rate", [1.0, 2.5])
def test_smooth_targets_are_followed_at_their_times_until_the_motion_rests_at_the_last_one(rate: float) -> None:
    targets = wave(rate=rate)
    motion = follow(targets, at_rest(targets.positions_rad[0]), BEGINS_S, LIMITS)
    assert_within_limits(motion)
    # The greatest speed is 1 rad/s; the arm starts at rest, so it has to catch up at first.
    apart = np.abs(motion.positions_rad - targets.at(BEGINS_S + motion.time_s))
    assert apart[motion.time_s > 0.6].max() < 0.02
    np.testing.assert_allclose(motion.positions_rad[-1], targets.positions_rad[-1], atol=1e-6)
    np.testing.assert_allclose(motion.velocities_rad_s[-1], 0.0, atol=1e-6)
    # It brakes before the last target and not beyond it.
    low, high = targets.positions_rad.min(axis=0), targets.positions_rad.max(axis=0)
    assert (setpoints(motion) <= high + 0.01).all()
    assert (setpoints(motion) >= low - 0.01).all()


@pytest.mark.parametrize("seed", range(12))
def test_no_targets_and_no_start_take_the_motion_beyond_velocity_acceleration_and_jerk(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, hz = int(rng.integers(2, 80)), float(rng.choice([5.0, 10.0, 30.0, 50.0]))
    steps = rng.normal(0.0, 0.3 * rng.random(), (count, 2)).cumsum(axis=0)
    targets = Targets(NAMES, BEGINS_S + np.arange(count) / hz, steps + rng.normal(0.0, 0.05, (count, 2)))
    at_s = BEGINS_S + rng.random() * (targets.end_s - BEGINS_S)
    start = (
        targets.at(np.array([at_s]))[0] + rng.normal(0.0, 0.1, 2),
        rng.uniform(-1.0, 1.0, 2) * LIMITS.velocity,
        rng.uniform(-0.7, 0.7, 2) * LIMITS.acceleration,
    )
    motion = follow(targets, start, at_s, LIMITS)
    assert (np.diff(motion.time_s) > 0.0).all()
    # A joint may start at its greatest velocity and accelerate still.
    velocity = np.diff(setpoints(motion), axis=0) / TICK_S
    assert (np.abs(velocity) <= 1.02 * LIMITS.velocity).all()
    assert (np.abs(np.diff(velocity, axis=0)) / TICK_S <= 1.02 * LIMITS.acceleration).all()


def test_noise_of_a_policy_is_averaged_out_within_the_jerk_limit() -> None:
    clean = wave(count=100)
    noise = np.random.default_rng(5).normal(0.0, 0.05, clean.positions_rad.shape)
    targets = Targets(NAMES, clean.time_s, clean.positions_rad + noise)
    motion = follow(targets, at_rest(clean.positions_rad[0]), BEGINS_S, LIMITS)
    assert_within_limits(motion)
    apart = np.abs(motion.positions_rad - clean.at(BEGINS_S + motion.time_s))
    assert apart.std() < 0.5 * noise.std()


def test_a_limit_of_the_jerk_is_kept() -> None:
    targets = wave()
    gentle = MotionLimits(LIMITS.velocity, LIMITS.acceleration, np.array([40.0, 40.0]))
    motion = follow(targets, at_rest(targets.positions_rad[0]), BEGINS_S, gentle)
    assert np.abs(np.diff(setpoints(motion), 3, axis=0) / TICK_S**3).max() <= 1.001 * 40.0


def test_late_targets_are_skipped_by_their_times() -> None:
    targets = wave()
    at_s = BEGINS_S + 0.7
    motion = follow(targets, at_rest(targets.at(np.array([at_s]))[0]), at_s, LIMITS)
    assert motion.duration_s == pytest.approx(targets.end_s - at_s, abs=0.2)


def shifted(by_rad: float, by_s: float) -> Targets:
    former = wave()
    return Targets(NAMES, former.time_s + by_s, former.at(former.time_s + by_s) + by_rad)


NOW_S = BEGINS_S + 0.8


def test_overlapping_chunks_are_joined_by_their_blend() -> None:
    for blend, weight, at_s, share in (
        (Blend.REPLACE, 0.0, NOW_S + 0.1, 1.0),
        (Blend.ENSEMBLE, 0.25, NOW_S + 0.1, 0.25),
        (Blend.REAL_TIME, 0.0, NOW_S + 0.001, 0.0),
        (Blend.REAL_TIME, 0.0, wave().end_s - 0.001, 1.0),
        (Blend.ENSEMBLE, 0.25, wave().end_s + 0.1, 1.0),
    ):
        former, new = wave(), shifted(0.1, 0.5)
        joined = blended(former, new, blend, weight, NOW_S)
        moment = np.array([at_s])
        wanted = share * new.at(moment) + (1.0 - share) * former.at(moment)
        np.testing.assert_allclose(joined.at(moment), wanted, atol=0.004)
        # What was before now stays, so that averages have it.
        np.testing.assert_allclose(joined.at(np.array([BEGINS_S + 0.3])), former.at(np.array([BEGINS_S + 0.3])))


def test_weights_of_real_time_chunking_fall_from_the_former_chunk_to_the_new_one() -> None:
    joined = blended(wave(), shifted(0.1, 0.5), Blend.REAL_TIME, 0.0, NOW_S)
    times_s = np.linspace(NOW_S + 0.01, wave().end_s - 0.01, 20)
    above = (joined.at(times_s) - wave().at(times_s))[:, 0]
    assert (np.diff(above) > -1e-3).all()
    assert above[0] < 0.01
    assert above[-1] > 0.09


def test_targets_of_an_hour_ago_are_not_kept_and_chunks_that_do_not_meet_not_blended() -> None:
    joined = wave()
    for number in range(100):
        joined = blended(joined, shifted(0.0, number / 3.0), Blend.REPLACE, 1.0, BEGINS_S + number / 3.0)
    assert len(joined.time_s) < 3 * len(wave().time_s)
    new = shifted(0.0, 5.0)
    assert blended(wave(), new, Blend.ENSEMBLE, 0.5, NOW_S) is new


def test_the_deviation_is_the_greatest_distance_from_the_targets() -> None:
    targets = wave()
    motion = follow(targets, at_rest(targets.positions_rad[0] + 0.1), BEGINS_S, LIMITS)
    np.testing.assert_allclose(deviation_rad(targets, motion, BEGINS_S), 0.1, atol=0.01)
