"""Metrics before they are text."""

from __future__ import annotations

from collections.abc import Iterable

from prometheus_client.core import Metric


def samples(metrics: Iterable[Metric]) -> dict[tuple[str, ...], float]:
    """Every sample by its name and the values of its labels."""
    return {(each.name, *each.labels.values()): each.value for family in metrics for each in family.samples}
