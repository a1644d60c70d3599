from __future__ import annotations

from server.operations.distribution import Distribution
from server.operations.metrics.distributions import histogram
from tests.helpers.metric_samples import samples


def test_each_bucket_holds_those_before_it() -> None:
    taken = Distribution((1.0, 2.0))
    for value in (0.5, 1.5, 1.75, 9.0):
        taken.take(value)
    assert samples([histogram("x_seconds", "X.", taken)]) == {
        ("x_seconds_bucket", "1.0"): 1,
        ("x_seconds_bucket", "2.0"): 3,
        ("x_seconds_bucket", "+Inf"): 4,
        ("x_seconds_count",): 4,
        ("x_seconds_sum",): 12.75,
    }
