"""Distributions as Prometheus has them."""

from __future__ import annotations

from itertools import accumulate

from prometheus_client.core import HistogramMetricFamily

from server.operations.distribution import Distribution


def histogram(name: str, meaning: str, distribution: Distribution) -> HistogramMetricFamily:
    """A histogram, whose buckets each hold those before them.

    Args:
        name: with its unit at the end.
        meaning: one sentence.
        distribution: the values.
    """
    bounds = [*map(str, distribution.bounds), "+Inf"]
    buckets = list(zip(bounds, accumulate(distribution.counts), strict=True))
    return HistogramMetricFamily(name, meaning, buckets=buckets, sum_value=distribution.total)
