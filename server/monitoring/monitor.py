"""Monitor of the server: HTTP routes for health and metrics, and a watch on its event loop for systemd.

Metrics are Prometheus': counters, and values read from the server's parts and processes at a scrape.
"""

import asyncio
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from http import HTTPStatus

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Histogram,
    ProcessCollector,
    disable_created_metrics,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from websockets.http11 import Request

from robot.faults import FaultCode
from robot.messages import ArmHealth, ArmState, Mode
from server.execution.goal import Answer
from server.gateway.http import HttpResponse, Route
from server.monitoring.health import Sources, check_health
from server.monitoring.systemd import SystemdNotifier

# Upper bounds of buckets [s]. A goal with many constraints takes seconds to plan; most take milliseconds.
PLANNING_TIME_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class GoalCounters(Collector):
    """Counters of answered goals."""

    def __init__(self) -> None:
        self._answered = Counter(
            "armbridge_goals",
            "Goals answered, by the topic or action they came by and the name of MoveIt's code.",
            ("source", "result"),
            registry=None,
        )
        self._planning_s = Histogram(
            "armbridge_goal_planning_seconds",
            "Time spent on planning, a goal.",
            buckets=PLANNING_TIME_BUCKETS_S,
            registry=None,
        )

    def count(self, source: str, answer: Answer) -> None:
        self._answered.labels(source, answer.code.name).inc()
        if answer.performed.planning_time_s > 0.0:
            self._planning_s.observe(answer.performed.planning_time_s)

    def collect(self) -> Iterator[Metric]:
        for each in (self._answered, self._planning_s):
            yield from each.collect()


# Upper bounds of buckets [s].
LOOP_LAG_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)

# A report comes once a second of the arm's time; an older one says nothing about its servos now.
ARM_HEALTH_STALE_S = 5.0

# Label values of a loop's and a bus's times, as the arm reports them. Prometheus keeps the label ``quantile`` for
# summaries, which count since the start.
STATISTICS = ("median", "p99", "max")

# Everything is counted from the server's start, whose time is a metric of its process.
disable_created_metrics()


class Metrics(Collector):
    """All metrics of the server: its parts are read at each scrape; between scrapes they only count."""

    def __init__(self, sources: Sources) -> None:
        self._sources = sources
        self.registry = CollectorRegistry(auto_describe=False)
        self.registry.register(self)
        self.loop_lag_s = Histogram(
            "armbridge_event_loop_lag_seconds",
            "Time by which the event loop woke up too late.",
            buckets=LOOP_LAG_BUCKETS_S,
            registry=self.registry,
        )
        ProcessCollector(namespace="armbridge", registry=self.registry)

    def collect(self) -> Iterator[Metric]:
        sources = self._sources
        health = check_health(sources)
        yield GaugeMetricFamily("armbridge_live", "Whether the server does what it can.", int(health.live))
        yield GaugeMetricFamily("armbridge_ready", "Whether /readyz answers 200.", int(health.ready))
        yield from figures(sources)
        if sources.goal_counters is not None:
            yield from sources.goal_counters.collect()
        if sources.arm is not None:
            yield from arm_metrics(sources.arm.state)
        if (arm_health := _fresh(sources.arm_health)) is not None:
            yield from arm_health_metrics(arm_health)


def _fresh(health: ArmHealth | None) -> ArmHealth | None:
    if health is None:
        return None
    age_s = (time.monotonic() - health.monotonic_s) * min(health.real_time_factor, 1.0)
    return None if age_s > ARM_HEALTH_STALE_S else health


def _by_label(name: str, meaning: str, label: str, values: Iterable[tuple[str, float]]) -> Metric:
    metric = GaugeMetricFamily(name, meaning, labels=(label,))
    for label_value, value in values:
        metric.add_metric((label_value,), value)
    return metric


def figures(sources: Sources) -> Iterator[Metric]:
    """Yield the metrics that have one value, of the parts that there are."""
    gauge, counter = GaugeMetricFamily, CounterMetricFamily
    if (traffic := sources.traffic) is not None:
        counts = traffic.counts()
        yield gauge("armbridge_clients", "Clients that are connected.", traffic.clients)
        yield gauge("armbridge_clients_queued_bytes", "What waits for all clients to read.", traffic.queued_bytes())
        yield counter("armbridge_connections", "Clients that have connected since the start.", traffic.connections)
        yield counter("armbridge_received_messages", "WebSocket messages from clients.", counts.received_messages)
        yield counter("armbridge_received_bytes", "Bytes from clients, with handshakes.", counts.received_bytes)
        yield counter("armbridge_sent_messages", "WebSocket messages that went to clients.", counts.sent_messages)
        yield counter("armbridge_sent_bytes", "Bytes of messages that went to clients.", counts.sent_bytes)
        yield counter("armbridge_dropped_messages", "Messages dropped for slow clients.", counts.dropped_messages)
    if (zenoh := sources.zenoh) is not None:
        yield counter("armbridge_zenoh_dropped_messages", "Messages lost on the way, or here.", zenoh.dropped)
    if (queue := sources.queue) is not None:
        yield gauge("armbridge_goals_waiting", "Goals that wait for their turn.", queue.waiting_count)
        yield gauge("armbridge_goals_in_hand", "Goals that are worked on.", queue.active_count)
    if (planners := sources.planners) is not None:
        yield gauge("armbridge_planners_waiting_requests", "Requests without a planner.", planners.waiting_count)
    if (recorder := sources.recorder) is not None:
        yield counter("armbridge_recording_dropped_messages", "Messages missing in the recording.", recorder.dropped)


# The arm; metrics of devices that an ideal arm does not have are left out.


def arm_metrics(state: ArmState) -> Iterator[Metric]:
    present = state.fault and state.fault.code
    modes = ((each.value, int(state.mode is each)) for each in Mode)
    faults = ((each.value, int(present is each)) for each in FaultCode)
    yield _by_label("armbridge_arm_mode", "1 for what the arm is doing, 0 for all else.", "mode", modes)
    yield _by_label("armbridge_arm_fault", "1 for the fault of the arm, 0 for others.", "code", faults)


def arm_health_metrics(health: ArmHealth) -> Iterator[Metric]:
    if health.bus is not None:
        for name, meaning, count in (
            ("instructions", "Instructions written to the bus.", health.bus.sent),
            ("replies", "Valid replies of servos.", health.bus.replies),
            ("timeouts", "Replies that did not come, or not soundly.", health.bus.timeouts),
            ("discarded_bytes", "Bytes that belonged to no valid reply.", health.bus.discarded_bytes),
            ("retries", "Instructions that were repeated.", health.bus.retries),
        ):
            yield CounterMetricFamily(f"armbridge_bus_{name}", f"{meaning} Since the bus was opened.", count)
        yield _statistics("armbridge_bus_round_trip_seconds", "Time that reading all servos took.", health.round_trip_s)
    yield _statistics("armbridge_arm_loop_lateness_seconds", "Start of ticks after deadlines.", health.lateness_s)
    measured = ((each.joint, each.temperature_c) for each in health.joints if not math.isnan(each.temperature_c))
    yield _by_label("armbridge_servo_temperature_celsius", "Temperature of a servo.", "joint", measured)


def _statistics(name: str, meaning: str, values_s: tuple[float, float, float]) -> Metric:
    values = zip(STATISTICS, values_s, strict=True)
    return _by_label(name, f"{meaning} Over the last second.", "statistic", values)


# Often enough to notice anything that blocks the loop, seldom enough to cost nothing.
PERIOD_S = 0.25

# sd_watchdog_enabled(3) recommends half the timeout between two notifications; a loop under load may miss one.
WATCHDOG_NOTIFICATIONS = 3.0


class Monitor:
    """Monitor of the server; it measures the lag of the event loop, and keeps systemd's watchdog."""

    def __init__(self, sources: Sources, notifier: SystemdNotifier, period_s: float = PERIOD_S) -> None:
        self._sources = sources
        self._notifier = notifier
        self._period_s = period_s
        self._watchdog_due_s = 0.0
        self.metrics = Metrics(sources)
        self.routes: Mapping[str, Route] = {
            "healthz": self._on_readyz,
            "readyz": self._on_readyz,
            "livez": self._on_livez,
            "metrics": self._on_metrics,
        }

    async def run(self) -> None:
        """Check regularly, until cancelled."""
        while True:
            due_s = time.monotonic() + self._period_s
            await asyncio.sleep(self._period_s)
            now_s = time.monotonic()
            self.metrics.loop_lag_s.observe(max(0.0, now_s - due_s))
            self.check(now_s)

    def check(self, now_s: float) -> None:
        """Notify systemd of the server being alive."""
        watchdog_s = self._notifier.watchdog_s
        if watchdog_s and now_s >= self._watchdog_due_s and check_health(self._sources).live:
            self._watchdog_due_s = now_s + watchdog_s / WATCHDOG_NOTIFICATIONS
            self._notifier.notify_watchdog()

    def notify_started(self) -> None:
        self._sources.started = True
        self._notifier.notify_ready()

    def notify_stopping(self, *, restarts: bool = False) -> None:
        """Note the begin of the stop, and notify systemd, which would end a service that restarts at once."""
        self._sources.stopping = True
        if not restarts:
            self._notifier.notify_stopping()

    async def _on_readyz(self, _request: Request) -> HttpResponse:
        health = check_health(self._sources)
        return health.response(good=health.live and health.ready)

    async def _on_livez(self, _request: Request) -> HttpResponse:
        health = check_health(self._sources)
        return health.response(good=health.live)

    async def _on_metrics(self, _request: Request) -> HttpResponse:
        return HttpResponse.of_data(HTTPStatus.OK, generate_latest(self.metrics.registry), CONTENT_TYPE_LATEST)
