import pytest

from planners.budget import Budget
from planners.problem import MoveItErrorCode


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def test_budget_lasts_until_the_allowed_time_is_spent(clock):
    budget = Budget(clock, 2.0, lambda: False)
    clock.now_s += 1.999
    assert not budget.used_up()
    clock.now_s += 0.001
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)


def test_budget_ends_when_asked_to_stop(clock):
    assert Budget(clock, 2.0, lambda: True).used_up()


def test_failure_for_lack_of_time_names_the_allowed_time(clock):
    budget = Budget(clock, 2.5, lambda: False)
    clock.now_s += 3.0
    failure = budget.failure()
    assert failure.code is MoveItErrorCode.TIMED_OUT
    assert "2.5 s" in failure.message


def test_failure_after_a_stop_is_preempted(clock):
    assert Budget(clock, 2.0, lambda: True).failure().code is MoveItErrorCode.PREEMPTED
