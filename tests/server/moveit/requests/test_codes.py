from __future__ import annotations

import pytest

from planners.problem import Deviation, MoveItErrorCode, PlanningFailure
from server.moveit.requests.error_codes import deviation_note, error_code, failure_code, success


@pytest.mark.parametrize("code", list(MoveItErrorCode))
def test_a_failure_keeps_its_code_and_its_sentence(code: MoveItErrorCode) -> None:
    told = failure_code(PlanningFailure(code, "so it is"))
    assert told == {"val": int(code), "message": "so it is", "source": "armbridge"}


def test_a_success_tells_what_the_caller_should_know_all_the_same() -> None:
    assert success("a", "", "b") == error_code(MoveItErrorCode.SUCCESS, "a; b")


def test_a_deviation_is_told_in_millimetres_and_degrees() -> None:
    note = deviation_note(Deviation(position_m=0.0042, orientation_rad=0.5))
    assert "4.2 mm" in note
    assert "28.6 degrees" in note


def test_a_deviation_below_what_the_arm_has_anyway_is_not_told() -> None:
    assert not deviation_note(Deviation(position_m=0.0005, orientation_rad=0.005))
