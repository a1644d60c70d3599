"""Numbers of stops."""

import time

import pytest

from robot.stop_epochs import StopEpochs


def test_numbers_increase_also_with_the_clock_set_back_and_a_later_run_begins_above_all_of_an_earlier_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times_s = iter((100.0, 100.0, 50.0, 101.0))
    monkeypatch.setattr(time, "time_ns", lambda: round(1e9 * next(times_s)))
    earlier, later = StopEpochs(), StopEpochs()
    assert [earlier.begin() for _ in range(3)] == [100_000_000, 100_000_001, 100_000_002]
    assert later.begin() > earlier.present
