from __future__ import annotations

from server.operations.distribution import Distribution


def test_a_value_counts_for_the_first_range_that_holds_it() -> None:
    taken = Distribution((1.0, 2.0))
    for value in (0.0, 1.0, 1.5, 2.0, 2.1, 99.0):
        taken.take(value)
    assert (taken.counts, taken.total) == ([2, 2, 2], 105.6)
