from __future__ import annotations

import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from server.errors import RefusedError
from server.moveit.requests.error_codes import invalid, refusals_as_data, refused, required


@refusals_as_data
def halved(value: int) -> int:
    if value % 2:
        raise invalid(f"value must be even, not {value}", value=value)
    return value // 2


def test_a_refusal_that_is_raised_comes_out_as_data() -> None:
    answer = halved(3)
    assert answer == PlanningFailure(
        MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, "value must be even, not 3", {"value": 3}
    )


def test_what_is_not_refused_comes_out_as_it_is() -> None:
    assert halved(4) == 2


def test_a_failure_where_something_is_required_is_raised() -> None:
    failure = PlanningFailure(MoveItErrorCode.INVALID_LINK_NAME, "no such link")
    with pytest.raises(RefusedError) as raised:
        required(failure)
    assert raised.value.failure is failure


def test_a_refusal_reads_as_its_sentence() -> None:
    assert str(refused(MoveItErrorCode.FAILURE, "not so")) == "not so"
