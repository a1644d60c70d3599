from __future__ import annotations

import pytest

from robot.messages import Course, Pace
from server.moveit.patience import DURATION_FACTOR, DURATION_MARGIN_S, LEAST_SPEED_FACTOR, MAX_PAUSED_S, Patience

DURATION_S = 3.0
ALLOWED_S = DURATION_S * DURATION_FACTOR + DURATION_MARGIN_S


def test_a_motion_may_take_its_allowance_and_no_longer() -> None:
    patience = Patience(DURATION_S)
    patience.pass_time(ALLOWED_S, Pace())
    assert patience.end is None
    patience.pass_time(0.1, Pace())
    assert f"{ALLOWED_S:.1f} s" in str(patience.end)


def test_a_slow_motion_uses_its_allowance_up_as_slowly() -> None:
    patience = Patience(DURATION_S)
    patience.pass_time(ALLOWED_S * 3.9, Pace(0.25))
    assert patience.end is None
    patience.pass_time(ALLOWED_S * 0.2, Pace(0.25))
    assert patience.end is not None


def test_what_is_gone_back_may_be_gone_again() -> None:
    patience = Patience(DURATION_S)
    patience.pass_time(ALLOWED_S, Pace())
    patience.pass_time(2.0, Pace(1.0, Course.BACK))
    patience.pass_time(1.9, Pace())
    assert patience.end is None


@pytest.mark.parametrize("pace", [Pace(1.0, Course.PAUSED), Pace(1.0, Course.BACK), Pace(LEAST_SPEED_FACTOR / 2)])
def test_no_motion_stands_or_goes_back_for_ever(pace: Pace) -> None:
    patience = Patience(DURATION_S)
    patience.pass_time(MAX_PAUSED_S, pace)
    assert patience.end is None
    patience.pass_time(1.0, pace)
    assert f"limit {MAX_PAUSED_S:g} s" in str(patience.end)
