"""Errors of requests, and the codes of responses."""

from __future__ import annotations

from planners.problem import MoveItErrorCode, PlanningFailure
from server.moveit.error_codes import (
    error_code,
    failure_code,
    invalid,
    refused,
    required,
    success,
)
from tests.helpers.moveit import rejection


def test_a_failure_keeps_its_code_and_its_sentence() -> None:
    for code in MoveItErrorCode:
        told = failure_code(PlanningFailure(code, "so it is"))
        assert told == {"val": int(code), "message": "so it is", "source": "armbridge"}


def test_a_success_has_its_notes_as_message() -> None:
    assert success("a", "", "b") == error_code(MoveItErrorCode.SUCCESS, "a; b")


def test_a_refusal_has_code_sentence_and_details() -> None:
    assert invalid("value must be even, not 3", value=3).failure == PlanningFailure(
        MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "value must be even, not 3", {"value": 3}
    )


def test_a_failure_that_is_required_not_to_be_one_is_raised() -> None:
    failure = PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, "no such link")
    raised = rejection(required, failure)
    assert raised is failure


def test_a_refusal_reads_as_its_sentence() -> None:
    assert str(refused(MoveItErrorCode.FAILURE, "not so")) == "not so"
