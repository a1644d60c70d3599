"""Following: phases, and velocities that keep all limits whatever the leader does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot.control.motion import VelocityTracking
from robot.description.limits import JointBounds
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S
from server.teleop.following import FollowerAct, Following, FollowingPhase, TrackingLimits, tracking_velocities

FRESH, STALE = 0.01, 0.3
TICK_S = 0.01
LIMITS = {"a": TrackingLimits(2.0, 6.0)}


def following() -> Following:
    one = Following()
    assert one.tick(0.0, FRESH) is FollowerAct.RAMP
    one.take_ramp_end("")
    return one


def test_it_ramps_once_and_then_follows() -> None:
    one = Following()
    assert [one.tick(0.0, FRESH) for _ in range(3)] == [FollowerAct.RAMP, FollowerAct.NOTHING, FollowerAct.NOTHING]
    one.take_ramp_end("")
    assert one.tick(0.1, FRESH) is FollowerAct.FOLLOW


def test_a_ramp_that_fails_ends_it_with_the_cause() -> None:
    one = Following()
    one.tick(0.0, FRESH)
    one.take_ramp_end("the goal collides")
    assert one.ended
    assert "the goal collides" in one.message


def test_an_open_clutch_holds_and_a_closed_one_ramps_again() -> None:
    one = following()
    assert one.set_clutch(closed=False) is FollowerAct.BRAKE
    assert one.tick(1.0, FRESH) is FollowerAct.NOTHING
    one.set_clutch(closed=True)
    assert one.tick(2.0, FRESH) is FollowerAct.RAMP


def test_a_closed_clutch_that_is_closed_again_changes_nothing() -> None:
    one = following()
    one.set_clutch(closed=True)
    assert one.tick(1.0, FRESH) is FollowerAct.FOLLOW


def test_samples_that_stop_during_the_ramp_brake_it() -> None:
    one = Following()
    one.tick(0.0, FRESH)
    assert one.tick(0.5, STALE) is FollowerAct.BRAKE
    one.take_ramp_end("")
    assert one.phase is FollowingPhase.BRAKING


def test_a_leader_that_jumps_makes_the_follower_hold_and_say_so() -> None:
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


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40), st.integers(1, 12))
def test_goals_never_jump_however_the_leader_moves(places: list[float], ticks_each: int) -> None:
    limits = LIMITS["a"]
    bounds = JointBounds(*(np.array([value]) for value in (-2.0, 2.0, 2.0, 6.0)))
    arm = VelocityTracking(bounds, np.zeros(1))
    jerk = limits.acceleration_rad_s2 / TIME_TO_FULL_ACCELERATION_S
    position, velocity, acceleration = 0.0, 0.0, None
    for place in places:
        for tick in range(ticks_each):
            if tick % 2 == 0:
                goal = {"a": float(arm.position_rad[0])}
                wanted = tracking_velocities(goal, {"a": place}, {"a": 0.0}, LIMITS, 0.0)
                arm.set_target(np.array([wanted["a"]]))
            arm.advance(TICK_S)
            assert abs(arm.position_rad[0] - position) <= limits.velocity_rad_s * TICK_S + 1e-6
            gained = arm.velocity_rad_s[0] - velocity
            assert abs(gained) <= limits.acceleration_rad_s2 * TICK_S + 1e-6
            if acceleration is not None:
                assert abs(gained / TICK_S - acceleration) <= jerk * TICK_S * 2.0 + 1e-4
            acceleration = gained / TICK_S
            position, velocity = float(arm.position_rad[0]), float(arm.velocity_rad_s[0])
            assert -2.0 - 1e-6 <= position <= 2.0 + 1e-6


@pytest.mark.parametrize("distance_rad", [0.05, 0.5, 1.5])
def test_a_follower_arrives_at_a_resting_leader_without_swinging_past(distance_rad: float) -> None:
    bounds = JointBounds(*(np.array([value]) for value in (-2.0, 2.0, 2.0, 6.0)))
    arm, farthest = VelocityTracking(bounds, np.zeros(1)), 0.0
    for tick in range(400):
        if tick % 2 == 0:
            wanted = tracking_velocities({"a": float(arm.position_rad[0])}, {"a": distance_rad}, {}, LIMITS, 0.0)
            arm.set_target(np.array([wanted["a"]]))
        farthest = max(farthest, float(arm.advance(TICK_S)[0]))
    assert arm.position_rad[0] == pytest.approx(distance_rad, abs=2e-3)
    assert farthest <= distance_rad + 0.01


def test_a_steady_leader_is_followed_without_lag() -> None:
    bounds = JointBounds(*(np.array([value]) for value in (-9.0, 9.0, 2.0, 6.0)))
    arm, place = VelocityTracking(bounds, np.zeros(1)), 0.0
    for _ in range(400):
        place += 1.0 * TICK_S
        wanted = tracking_velocities({"a": float(arm.position_rad[0])}, {"a": place}, {"a": 1.0}, LIMITS, 0.0)
        arm.set_target(np.array([wanted["a"]]))
        arm.advance(TICK_S)
    assert arm.position_rad[0] == pytest.approx(place, abs=0.02)
