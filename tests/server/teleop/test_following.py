"""Following: phases, and velocities that keep all limits whatever the leader does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.control.motion import VelocityTracking
from robot.description.limits import JointBounds
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S
from server.teleop.following import FollowerAct, Following, FollowingPhase, TrackingLimits, tracking_velocity

FRESH, STALE = 0.01, 0.3
TICK_S = 0.01
LIMITS = TrackingLimits(2.0, 6.0)


def following() -> Following:
    one = Following()
    assert [one.tick(0.0, FRESH) for _ in range(3)] == [FollowerAct.RAMP, FollowerAct.NOTHING, FollowerAct.NOTHING]
    one.take_ramp_end("")
    return one


def test_a_ramp_that_fails_ends_it_with_the_cause_and_samples_that_stop_brake_it() -> None:
    one = Following()
    one.tick(0.0, FRESH)
    one.take_ramp_end("the goal collides")
    assert one.ended
    assert "the goal collides" in one.message
    one = Following()
    one.tick(0.0, FRESH)
    assert one.tick(0.5, STALE) is FollowerAct.BRAKE
    one.take_ramp_end("")
    assert one.phase is FollowingPhase.BRAKING


def test_it_follows_after_one_ramp_and_holds_while_the_clutch_is_open_or_when_the_leader_jumps() -> None:
    one = following()
    assert one.tick(0.1, FRESH) is FollowerAct.FOLLOW
    one.set_clutch(closed=True)
    assert one.tick(1.0, FRESH) is FollowerAct.FOLLOW
    assert one.set_clutch(closed=False) is FollowerAct.BRAKE
    assert one.tick(2.0, FRESH) is FollowerAct.NOTHING
    one.set_clutch(closed=True)
    assert one.tick(3.0, FRESH) is FollowerAct.RAMP
    one = following()
    assert one.tick(1.0, FRESH, jump="a jumped") is FollowerAct.BRAKE
    assert one.phase is FollowingPhase.HOLDING
    assert one.message == "a jumped: close the clutch to go on"


@pytest.mark.parametrize("before", ["ramping", "following", "holding"])
def test_a_follower_that_cannot_go_on_ends_once_from_every_phase(before: str) -> None:
    one = Following() if before == "ramping" else following()
    if before == "holding":
        one.set_clutch(closed=False)
    ticks = [one.tick(now_s, FRESH, obstacle="the arm has a fault") for now_s in (1.0, 1.1)]
    assert ticks == [FollowerAct.BRAKE, FollowerAct.NOTHING]
    assert one.message == "the arm has a fault"


class Tracking:
    """A joint between two limits that is steered after a leader, every other tick."""

    def __init__(self, range_rad: float = 2.0) -> None:
        bounds = JointBounds(*(np.array([value]) for value in (-range_rad, range_rad, 2.0, 6.0)))
        self._joint, self._ticks = VelocityTracking(bounds, np.zeros(1)), 0

    def follow(self, place_rad: float, velocity_rad_s: float = 0.0) -> tuple[float, float]:
        """Do a tick; returns position [rad] and velocity [rad/s]."""
        if self._ticks % 2 == 0:
            error_rad = place_rad - float(self._joint.position_rad[0])
            self._joint.set_target(np.array([tracking_velocity(error_rad, velocity_rad_s, LIMITS, 0.0)]))
        self._ticks += 1
        self._joint.advance(TICK_S)
        return float(self._joint.position_rad[0]), float(self._joint.velocity_rad_s[0])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40), st.integers(1, 12))
def test_goals_never_jump_however_the_leader_moves(places: list[float], ticks_each: int) -> None:
    jerk = LIMITS.acceleration_rad_s2 / TIME_TO_FULL_ACCELERATION_S
    ticks = [(0.0, 0.0)]
    tracking = Tracking()
    ticks += [tracking.follow(place) for place in places for _ in range(ticks_each)]
    position, velocity = np.array(ticks).T
    acceleration = np.diff(velocity) / TICK_S
    assert np.abs(position).max() <= 2.0 + 1e-6
    assert np.abs(np.diff(position)).max() <= LIMITS.velocity_rad_s * TICK_S + 1e-6
    assert np.abs(acceleration).max() <= LIMITS.acceleration_rad_s2 + 1e-4
    assert np.abs(np.diff(acceleration)).max(initial=0.0) <= jerk * TICK_S * 2.0 + 1e-4


@pytest.mark.parametrize("distance_rad", [0.05, 0.5, 1.5])
def test_a_follower_arrives_at_a_resting_leader_without_swinging_past(distance_rad: float) -> None:
    tracking = Tracking()
    positions = [tracking.follow(distance_rad)[0] for _ in range(400)]
    assert positions[-1] == pytest.approx(distance_rad, abs=2e-3)
    assert max(positions) <= distance_rad + 0.01


def test_a_steady_leader_is_followed_without_lag() -> None:
    tracking = Tracking(9.0)
    positions = [tracking.follow(tick * TICK_S, 1.0)[0] for tick in range(1, 401)]
    assert positions[-1] == pytest.approx(4.0, abs=0.02)
