"""Errors of requests, and the codes of responses."""

from __future__ import annotations

import pytest

from planners.problem import Deviation, MoveItErrorCode, PlanningFailure
from server.errors import RefusedError
from server.moveit.requests.error_codes import (
    deviation_note,
    error_code,
    failure_code,
    invalid,
    required,
    success,
)


def test_a_failure_keeps_its_code_and_its_sentence() -> None:
    for code in MoveItErrorCode:
        told = failure_code(PlanningFailure(code, "so it is"))
        assert told == {"val": int(code), "message": "so it is", "source": "armbridge"}


def test_a_success_has_its_notes_as_message() -> None:
    assert success("a", "", "b") == error_code(MoveItErrorCode.SUCCESS, "a; b")


def test_a_deviation_is_described_in_millimetres_and_degrees() -> None:
    note = deviation_note(Deviation(position_m=0.0042, orientation_rad=0.5))
    assert "4.2 mm" in note
    assert "28.6 degrees" in note


def test_a_deviation_within_the_arms_accuracy_is_not_described() -> None:
    assert not deviation_note(Deviation(position_m=0.0005, orientation_rad=0.005))


def test_a_refusal_has_code_sentence_and_details() -> None:
    assert invalid("value must be even, not 3", value=3).failure == PlanningFailure(
        MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "value must be even, not 3", {"value": 3}
    )


def test_a_failure_that_is_required_not_to_be_one_is_raised() -> None:
    failure = PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, "no such link")
    with pytest.raises(RefusedError) as raised:
        required(failure)
    assert raised.value.failure is failure
