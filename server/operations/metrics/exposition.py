"""The text that Prometheus reads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from robot.messages import ArmHealth
from server.operations.distribution import Distribution
from server.operations.health import health_of
from server.operations.metrics.arm import arm_metrics, condition_metrics
from server.operations.metrics.clients import client_metrics, refusal_metrics, zenoh_metrics
from server.operations.metrics.goals import goal_metrics, planner_metrics, queue_metrics, recording_metrics
from server.operations.metrics.processes import build_metrics, loop_metrics, process_metrics
from server.operations.parts import Parts

# The arm's condition comes once a second of the arm's time; what is older says nothing of its servos now.
CONDITION_STALE_S = 5.0

Part = TypeVar("Part")


class Exposed(NamedTuple):
    """A text, and what its format is called in HTTP."""

    text: bytes
    media_type: str


class PartsCollector(Collector):
    """Reads every part when it is asked; nobody counts anything for metrics' sake meanwhile.

    Args:
        parts: the server's.
        lag_s: of the event loop.
        started_s: wall-clock time at which the server started [s since the epoch].
    """

    def __init__(self, parts: Parts, lag_s: Distribution, started_s: float) -> None:
        self._parts = parts
        self._lag_s = lag_s
        self._started_s = started_s

    def describe(self) -> Iterable[Metric]:
        """Nothing: the registry need not ask for all metrics to learn their names."""
        return ()

    def collect(self) -> Iterator[Metric]:
        """Every metric."""
        parts = self._parts
        health = health_of(parts)
        yield GaugeMetricFamily("armbridge_live", "Whether the server does what it can.", int(health.live))
        yield GaugeMetricFamily("armbridge_ready", "Whether /readyz answers 200.", int(health.ready))
        yield GaugeMetricFamily("armbridge_start_time_seconds", "When the server started.", self._started_s)
        yield from _of(parts.traffic, client_metrics)
        yield from _of(parts.refused_connections, refusal_metrics)
        yield from _of(parts.zenoh, zenoh_metrics)
        yield from _of(parts.goal_tally, goal_metrics)
        yield from _of(parts.queue, queue_metrics)
        yield from _of(parts.planners, planner_metrics)
        yield from _of(parts.recorder, recording_metrics)
        yield from _of(parts.arm, arm_metrics)
        yield from _of(_fresh(parts.arm_health), condition_metrics)
        yield from loop_metrics(self._lag_s)
        yield from process_metrics(parts.children())
        yield from build_metrics()


def _of(part: Part | None, metrics: Callable[[Part], Iterator[Metric]]) -> Iterator[Metric]:
    """The metrics of a part, none while it is not there."""
    return iter(()) if part is None else metrics(part)


def _fresh(health: ArmHealth | None) -> ArmHealth | None:
    """The arm's condition, unless it is what it was before the arm was lost."""
    if health is None or (time.time() - health.stamp_s) * health.real_time_factor > CONDITION_STALE_S:
        return None
    return health


class Exposition:
    """Makes the text.

    Args:
        parts: the server's.
        lag_s: of the event loop.
        started_s: wall-clock time at which the server started [s since the epoch].
    """

    def __init__(self, parts: Parts, lag_s: Distribution, started_s: float | None = None) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(PartsCollector(parts, lag_s, time.time() if started_s is None else started_s))

    def expose(self, accept: str) -> Exposed:
        """The metrics of this moment, in the format that is wanted.

        Args:
            accept: the request's header of that name; empty for the plain text of Prometheus.
        """
        encode, media_type = choose_encoder(accept)
        return Exposed(encode(self._registry), media_type)
