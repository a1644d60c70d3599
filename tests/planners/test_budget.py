import pytest

from planners.budget import Budget
from planners.problem import MoveItErrorCode
from tests.helpers.clock import FakeClock


def test_a_budget_and_its_shares_last_until_the_allowed_time_is_spent_or_they_are_asked_to_stop():
    clock = FakeClock()
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.0)
    part = budget.share(0.5)
    assert part.left_s == pytest.approx(0.5)
    clock.advance(0.75)
    assert (part.used_up(), budget.used_up()) == (True, False)
    assert budget.left_s == pytest.approx(0.25)
    clock.advance(0.249)
    assert not budget.used_up()
    clock.advance(0.001)
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)
    assert budget.failure().code is MoveItErrorCode.TIMED_OUT
    assert "2 s" in budget.failure().message
    stopped = Budget(clock, 2.0, lambda: True)
    assert stopped.used_up()
    assert stopped.share(0.5).used_up()
    assert stopped.failure().code is MoveItErrorCode.PREEMPTED
