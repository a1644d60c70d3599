import pytest

from planners.budget import Budget
from planners.problem import MoveItErrorCode
from tests.helpers.clock import FakeClock


@pytest.fixture
def clock():
    return FakeClock()


def test_budget_lasts_until_the_allowed_time_is_spent(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.999)
    assert not budget.used_up()
    clock.advance(0.001)
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)
    assert budget.failure().code is MoveItErrorCode.TIMED_OUT
    assert "2 s" in budget.failure().message


def test_budget_and_its_shares_end_when_asked_to_stop(clock):
    budget = Budget(clock, 2.0, lambda: True)
    assert budget.used_up()
    assert budget.share(0.5).used_up()
    assert budget.failure().code is MoveItErrorCode.PREEMPTED


def test_a_share_of_a_budget_is_of_the_time_that_is_left(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.0)
    part = budget.share(0.5)
    assert part.left_s == pytest.approx(0.5)
    clock.advance(0.6)
    assert part.used_up()
    assert not budget.used_up()
    assert budget.left_s == pytest.approx(0.4)
