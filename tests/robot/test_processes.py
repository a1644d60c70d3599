"""The delay before a child is started again; tests/processes has the children themselves."""

import pytest

from robot.processes import RestartDelay


@pytest.mark.parametrize(
    ("ran_s", "delays_s"),
    [
        ([0.0] * 8, [0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0]),
        ([3600.0, 5.0, 1.0], [0.0, 0.0, 0.0]),
        ([0.9, 0.9, 0.0, 1.0, 0.0, 0.9], [0.2, 0.4, 0.8, 0.0, 0.2, 0.4]),
    ],
)
def test_the_delay_before_a_start_follows_how_long_the_processes_ran(ran_s: list[float], delays_s: list[float]) -> None:
    delay = RestartDelay(0.2, 10.0)
    assert [delay.after(each) for each in ran_s] == delays_s
