"""Monitor of the server: HTTP routes for health and metrics, and a watch on its event loop that systemd hears of.

Metrics are Prometheus': counters, and values read from the server's parts and processes at a scrape.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from http import HTTPStatus
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    ProcessCollector,
    disable_created_metrics,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector
from websockets.http11 import Request

from robot.faults import FaultCode
from robot.messages import ArmHealth, JointHealth, Mode
from server.execution.goal import Answer
from server.gateway.connection import Traffic
from server.gateway.http import HttpResponse, Route
from server.monitoring.health import Sources, check_health
from server.monitoring.systemd import SystemdNotifier

if TYPE_CHECKING:
    from planners.interface import Planners
    from robot.arm_group import AnyArm
    from server.execution.queue import GoalQueue
    from server.recording.recorder import Recorder
    from server.zenoh.bridge import Bridge

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

# Metrics of ProcessCollector that are exposed: those that docs/operations.md documents.
PROCESS_METRICS = (
    "armbridge_process_resident_memory_bytes",
    "armbridge_process_open_fds",
    "armbridge_process_cpu_seconds",
)

_SERVO_METRICS: tuple[tuple[str, str, Callable[[JointHealth], float]], ...] = (
    ("armbridge_servo_temperature_celsius", "Temperature of a servo.", lambda servo: servo.temperature_c),
    ("armbridge_servo_voltage_volts", "Voltage at a servo.", lambda servo: servo.voltage_v),
    ("armbridge_servo_current_amperes", "Current of a servo's motor, signed.", lambda servo: servo.current_a),
    ("armbridge_servo_load_ratio", "Share of the motor's full duty, signed.", lambda servo: servo.load),
    ("armbridge_servo_reply_age_seconds", "Time since a servo's last good reply.", lambda servo: servo.age_s),
)

# Everything is counted from the server's start, whose time is a metric of its own.
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
        started = Gauge("armbridge_start_time_seconds", "When the server started.", registry=self.registry)
        started.set_to_current_time()
        build = Info("armbridge_build", "Version of armbridge and of Python.", registry=self.registry)
        build.info({"version": metadata.version("armbridge"), "python": platform.python_version()})

    def expose(self, accept: str) -> tuple[bytes, str]:
        """Return the metrics as the header Accept asks, else as Prometheus' text, and their media type."""
        encode, media_type = choose_encoder(accept)
        return encode(self.registry), media_type

    def collect(self) -> Iterator[Metric]:
        sources = self._sources
        health = check_health(sources)
        yield GaugeMetricFamily("armbridge_live", "Whether the server does what it can.", int(health.live))
        yield GaugeMetricFamily("armbridge_ready", "Whether /readyz answers 200.", int(health.ready))
        parts: tuple[tuple[Any, Callable[[Any], Iterator[Metric]]], ...] = (
            (sources.traffic, client_metrics),
            (sources.refused_connections, refusal_metrics),
            (sources.zenoh, zenoh_metrics),
            (sources.goal_counters, GoalCounters.collect),
            (sources.queue, queue_metrics),
            (sources.planners, planner_metrics),
            (sources.recorder, recording_metrics),
            (sources.arm, arm_metrics),
            (_fresh(sources.arm_health), arm_health_metrics),
        )
        for part, metrics in parts:
            if part is not None:
                yield from metrics(part)
        yield from process_metrics({"server": os.getpid(), **sources.children()})


def _fresh(health: ArmHealth | None) -> ArmHealth | None:
    if health is None:
        return None
    age_s = (time.monotonic() - health.monotonic_s) * min(health.real_time_factor, 1.0)
    return None if age_s > ARM_HEALTH_STALE_S else health


def _by_label(
    family: type[CounterMetricFamily | GaugeMetricFamily],
    name: str,
    meaning: str,
    label: str,
    values: Iterable[tuple[str, float]],
) -> Metric:
    made = family(name, meaning, labels=(label,))
    for of_label, value in values:
        made.add_metric((of_label,), value)
    return made


# Clients and other machines.


def client_metrics(traffic: Traffic) -> Iterator[Metric]:
    counts = traffic.counts()
    queued_bytes, most_queued_bytes = traffic.queued_bytes()
    yield GaugeMetricFamily("armbridge_clients", "Clients that are connected.", traffic.clients)
    yield GaugeMetricFamily("armbridge_clients_queued_bytes", "What waits for all clients to read.", queued_bytes)
    yield GaugeMetricFamily(
        "armbridge_clients_queued_greatest_bytes", "What waits for the slowest client to read.", most_queued_bytes
    )
    for name, meaning, value in (
        ("armbridge_connections", "Clients that have connected since the start.", traffic.connections),
        ("armbridge_received_messages", "WebSocket messages that came from clients.", counts.received_messages),
        ("armbridge_received_bytes", "Bytes that came from clients, handshakes included.", counts.received_bytes),
        ("armbridge_sent_messages", "WebSocket messages that went to clients.", counts.sent_messages),
        ("armbridge_sent_bytes", "Bytes of messages that went to clients.", counts.sent_bytes),
        (
            "armbridge_dropped_messages",
            "Messages on topics that clients did not get because they read too slowly.",
            counts.dropped_messages,
        ),
        ("armbridge_refused_operations", "Operations that were not carried out.", counts.refused_operations),
    ):
        yield CounterMetricFamily(name, meaning, value)


def refusal_metrics(refused_connections: Callable[[], Mapping[str, int]]) -> Iterator[Metric]:
    meaning = "Connections and requests that were not let in, by why."
    refused = refused_connections().items()
    yield _by_label(CounterMetricFamily, "armbridge_refused_connections", meaning, "reason", refused)


def zenoh_metrics(zenoh: Bridge) -> Iterator[Metric]:
    yield CounterMetricFamily(
        "armbridge_zenoh_dropped_messages", "Messages lost because network or server were too slow.", zenoh.dropped
    )


# Goals, planners, the recording.


def queue_metrics(queue: GoalQueue) -> Iterator[Metric]:
    yield GaugeMetricFamily("armbridge_goals_waiting", "Goals that wait for their turn.", queue.waiting_count)
    yield GaugeMetricFamily("armbridge_goals_in_hand", "Goals that are worked on.", queue.active_count)


def planner_metrics(planners: Planners) -> Iterator[Metric]:
    for state, count in (("loaded", planners.loaded_count), ("idle", planners.idle_count)):
        yield GaugeMetricFamily(f"armbridge_planners_{state}", f"Planner processes that are {state}.", count)
    yield GaugeMetricFamily(
        "armbridge_planners_waiting_requests", "Requests that wait for a planner.", planners.waiting_count
    )


def recording_metrics(recorder: Recorder) -> Iterator[Metric]:
    yield GaugeMetricFamily("armbridge_recording", "Whether messages are recorded.", int(not recorder.ended))
    yield GaugeMetricFamily("armbridge_recording_waiting_messages", "Messages that wait for the file.", recorder.queued)
    yield CounterMetricFamily(
        "armbridge_recording_dropped_messages", "Messages missing in the recording.", recorder.dropped
    )


# The arm; metrics of devices that an ideal arm does not have are left out.


def arm_metrics(arm: AnyArm) -> Iterator[Metric]:
    state, present = arm.state, arm.state.fault and arm.state.fault.code
    modes = ((each.value, int(state.mode is each)) for each in Mode)
    faults = ((each.value, int(present is each)) for each in FaultCode)
    meaning = "1 for what the arm is doing, 0 for all else."
    yield _by_label(GaugeMetricFamily, "armbridge_arm_mode", meaning, "mode", modes)
    meaning = "1 for the fault of the arm, 0 for others."
    yield _by_label(GaugeMetricFamily, "armbridge_arm_fault", meaning, "code", faults)
    yield GaugeMetricFamily("armbridge_arm_state_age_seconds", "Time since the last state came.", arm.state_age_s)


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
    yield _statistics(
        "armbridge_arm_loop_lateness_seconds", "Start of the loop's ticks after their deadlines.", health.lateness_s
    )
    yield GaugeMetricFamily("armbridge_arm_real_time", "Whether the loop has real-time priority.", health.real_time)
    yield GaugeMetricFamily(
        "armbridge_arm_real_time_factor",
        "Seconds of the arm's time that pass in one second; below 1 where a busy machine slows a simulated arm down.",
        health.real_time_factor,
    )
    for name, meaning, value_of in _SERVO_METRICS:
        values = ((joint.joint, value_of(joint)) for joint in health.joints)
        measured = ((joint, value) for joint, value in values if not math.isnan(value))
        yield _by_label(GaugeMetricFamily, name, meaning, "joint", measured)
    silent = ((joint.joint, joint.silent_cycles) for joint in health.joints)
    meaning = "Cycles in which a servo did not answer."
    yield _by_label(CounterMetricFamily, "armbridge_servo_silent_cycles", meaning, "joint", silent)


def _statistics(name: str, meaning: str, values_s: tuple[float, float, float]) -> Metric:
    values = zip(STATISTICS, values_s, strict=True)
    return _by_label(GaugeMetricFamily, name, f"{meaning} Over the last second.", "statistic", values)


# Processes.


def process_metrics(processes: Mapping[str, int]) -> Iterator[Metric]:
    """Yield the metrics of processes; those that have ended have none."""
    threads = GaugeMetricFamily("armbridge_process_threads", "Threads.", labels=("process",))
    families: dict[str, Metric] = {}
    for name, pid in processes.items():
        for found in ProcessCollector(namespace="armbridge", pid=partial(int, pid), registry=None).collect():
            if found.name in PROCESS_METRICS:
                family = families.setdefault(found.name, Metric(found.name, found.documentation, found.type))
                family.samples += [sample._replace(labels={"process": name}) for sample in found.samples]
        # ProcessCollector does not count them.
        with contextlib.suppress(OSError):
            threads.add_metric((name,), sum(1 for _ in Path(f"/proc/{pid}/task").iterdir()))
    yield from (*families.values(), threads)


# Often enough to notice anything that blocks the loop, seldom enough to cost nothing.
PERIOD_S = 0.25

# sd_watchdog_enabled(3) recommends half the timeout between two notifications; a loop under load may miss one.
WATCHDOG_NOTIFICATIONS = 3.0


class Monitor:
    """Monitor of the server; it measures the lag of the event loop, and keeps systemd's watchdog and status line."""

    def __init__(self, sources: Sources, notifier: SystemdNotifier, period_s: float = PERIOD_S) -> None:
        self._sources = sources
        self._notifier = notifier
        self._period_s = period_s
        self._watchdog_due_s = 0.0
        self._status = ""
        self.metrics = Metrics(sources)
        self.routes: Mapping[str, Route] = {
            "healthz": self._on_readyz,
            "readyz": self._on_readyz,
            "livez": self._on_livez,
            "metrics": self._on_metrics,
        }

    async def run(self) -> None:
        """Check at once, so that systemd knows of the start however quick it is, then regularly, until cancelled."""
        self.check(time.monotonic())
        while True:
            due_s = time.monotonic() + self._period_s
            await asyncio.sleep(self._period_s)
            now_s = time.monotonic()
            self.metrics.loop_lag_s.observe(max(0.0, now_s - due_s))
            self.check(now_s)

    def check(self, now_s: float) -> None:
        """Notify systemd of changes, and of the server being alive."""
        watchdog_s = self._notifier.watchdog_s
        health = check_health(self._sources)
        status = "; ".join(health.reasons or health.warnings) or "ready"
        if status != self._status:
            self._status = status
            self._notifier.notify_status(status)
        if watchdog_s and health.live and now_s >= self._watchdog_due_s:
            self._watchdog_due_s = now_s + watchdog_s / WATCHDOG_NOTIFICATIONS
            self._notifier.notify_watchdog()

    def notify_started(self) -> None:
        self._sources.started = True
        self._notifier.notify_ready("; ".join(check_health(self._sources).reasons) or "ready")

    def notify_stopping(self, *, restarts: bool = False) -> None:
        """Note the begin of the stop, and notify systemd, which would end a service that restarts at once."""
        self._sources.stopping = True
        if restarts:
            self._notifier.notify_status("starting again")
        else:
            self._notifier.notify_stopping()

    async def _on_readyz(self, _request: Request) -> HttpResponse:
        health = check_health(self._sources)
        return health.response(good=health.live and health.ready)

    async def _on_livez(self, _request: Request) -> HttpResponse:
        health = check_health(self._sources)
        return health.response(good=health.live)

    async def _on_metrics(self, request: Request) -> HttpResponse:
        text, media_type = self.metrics.expose(", ".join(request.headers.get_all("Accept")))
        return HttpResponse.of_data(HTTPStatus.OK, text, media_type)
