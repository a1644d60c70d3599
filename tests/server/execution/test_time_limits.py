import math

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from robot.messages import Pace, PlaybackDirection
from server.execution.goal import MIN_SPEED_FACTOR, ArmStopwatch, ExecutionDeadline, TimeLimits
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import FakeArm
from tests.helpers.moveit import rejection

DURATION_S = 3.0
LIMITS = TimeLimits(scaling=3.0, margin_s=4.0, paused_s=50.0)
ALLOWED_S = 13.0


@pytest.mark.parametrize("duration_s", [12.5, math.inf, math.nan])
def test_a_motion_that_takes_too_long_is_refused_with_field_limit_and_value(duration_s: float) -> None:
    limits, code = TimeLimits(trajectory_s=12.0), MoveItErrorCode.INVALID_MOTION_PLAN
    limits.check_duration(12.0, "points[3]", code)
    raised = rejection(limits.check_duration, duration_s, "points[3]", code, ": hurry")
    assert raised == PlanningFailure(
        code,
        f"points[3] is {duration_s:g} s, longer than goals.max_trajectory_duration_s = 12: hurry",
        {"duration_s": duration_s, "limit_s": 12.0},
    )


def test_a_slow_motion_has_longer_and_the_way_back_is_credited() -> None:
    deadline = ExecutionDeadline(LIMITS)
    deadline.begin(DURATION_S)
    deadline.pass_time(2.0 * ALLOWED_S, Pace(0.5))
    deadline.pass_time(4.0, Pace(0.5, PlaybackDirection.BACK))
    deadline.pass_time(1.9, Pace())
    assert deadline.exceeded is None
    deadline.pass_time(0.2, Pace())
    assert deadline.exceeded == "the arm did not end the motion within 13.0 s"


@pytest.mark.parametrize(
    "pace", [Pace(1.0, PlaybackDirection.PAUSED), Pace(1.0, PlaybackDirection.BACK), Pace(MIN_SPEED_FACTOR / 2)]
)
def test_the_time_of_paused_and_reversed_motions_is_limited(pace: Pace) -> None:
    deadline = ExecutionDeadline(LIMITS)
    deadline.begin(DURATION_S)
    deadline.pass_time(50.0, pace)
    assert deadline.exceeded is None
    deadline.pass_time(1.0, pace)
    assert "limit 50 s" in str(deadline.exceeded)


LAPS = {
    "arm and machine": (0.5, 0.5, 0.5),
    "an arm that is starved": (0.5, 0.1, 0.1),
    "a server that stood still before": (0.1, 3.0, 0.1),
    "an arm that says nothing": (0.5, 0.0, 0.0),
    "another arm process": (0.5, -7.0, 0.0),
}


@pytest.mark.parametrize(("here_s", "by_arm_s", "passed_s"), LAPS.values(), ids=LAPS.keys())
def test_the_arms_time_is_that_of_its_clock_and_no_more_than_passes_here(
    here_s: float, by_arm_s: float, passed_s: float
) -> None:
    arm, clock = FakeArm(), FakeClock()
    time = ArmStopwatch(arm, clock)
    for _ in range(2):
        clock.advance(here_s)
        arm.pass_time(by_arm_s)
        assert time.elapsed_s() == pytest.approx(passed_s)
    assert time.elapsed_s() == 0.0
