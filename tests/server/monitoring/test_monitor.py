import asyncio
import json
import math
import re
import urllib.error
import urllib.request
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from prometheus_client import generate_latest
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families as parse
from websockets.datastructures import Headers
from websockets.http11 import Request

from harness.clients import ArmClient, values_of
from harness.server import ROOT, ServerOnBus
from harness.waiting import TIMEOUT_S, wait_until
from planners.problem import MoveItErrorCode
from robot.faults import FaultCode
from robot.messages import Mode
from server.execution.goal import Answer
from server.execution.motions import NOTHING, Performed
from server.gateway.connection import Traffic, TrafficCounts
from server.monitoring import monitor as parts
from server.monitoring.health import Health, Sources, check_health
from server.monitoring.monitor import GoalCounters, Metrics, Monitor
from server.monitoring.systemd import SystemdNotifier
from tests.helpers.clock import SteppedLoop
from tests.helpers.cost import count_calls
from tests.server.monitoring import watched_parts as watched
from tests.server.monitoring.watched_parts import NOW_S, WatchedArm, WatchedRecorder, arm_health, arm_state
from tests.test_readme import blocks

# A scrape holds the event loop up; this many calls take some 2 ms.
SCRAPE_CALLS = 20_000


def samples(metrics: Iterable[Metric]) -> dict[tuple[str, ...], float]:
    """Every sample by its name and the values of its labels."""
    return {(each.name, *each.labels.values()): each.value for family in metrics for each in family.samples}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The monitor's clocks, which stand; all is watched at this time."""
    stands = SimpleNamespace(monotonic=lambda: NOW_S, time=lambda: NOW_S)
    monkeypatch.setattr(parts, "time", stands)
    return stands


@pytest.fixture
def sources(clock: SimpleNamespace) -> Sources:
    return watched.watched_sources()


def exposed(sources: Sources) -> Mapping[str, float]:
    """Every sample by its name and labels, none of which comes twice."""
    found = [
        (each.name + "".join(f" {key}={value}" for key, value in sorted(each.labels.items())), each.value)
        for family in parse(generate_latest(Metrics(sources).registry).decode())
        for each in family.samples
    ]
    assert len(found) == len(dict(found))
    return dict(found)


def test_absent_parts_have_no_metrics() -> None:
    found = exposed(Sources())
    assert found["armbridge_ready"] == 0
    assert not [name for name in found if re.search("servo|client|goal", name)]


# Age of the report beyond the limit [s], and its real time factor: a slow simulated arm reports as seldom as it passes.
@pytest.mark.parametrize(
    ("age_s", "factor", "told"),
    [(-0.1, 1.0, True), (1.0, 1.0, False), (1.0, 0.25, True), (-0.1, 10.0, True)],
)
@pytest.mark.parametrize("jump_s", [0.0, 6.3e8])
def test_an_old_condition_is_not_told_as_if_it_were_the_present_one(
    sources: Sources, clock: SimpleNamespace, age_s: float, factor: float, jump_s: float, told: bool
) -> None:
    sources.arm_health = replace(arm_health(), real_time_factor=factor)
    clock.monotonic = lambda: NOW_S + parts.ARM_HEALTH_STALE_S + age_s
    # That the machine's clock was set makes no report an old one.
    clock.time = lambda: clock.monotonic() + jump_s
    found = [name for name in exposed(sources) if name.startswith(("armbridge_servo", "armbridge_bus"))]
    assert bool(found) is told


def test_nothing_that_strangers_choose_becomes_a_label(sources: Sources) -> None:
    """However long the server runs, there are no more series than joints, faults, processes and results."""
    assert sources.goal_counters is not None
    for code in MoveItErrorCode:
        sources.goal_counters.count("/moveit_goal_pose", Answer(code, "words of a client"))
    sources.arm = WatchedArm(arm_state(fault=FaultCode.OVERHEATED))
    found = exposed(sources)
    assert len([name for name in found if name.startswith("armbridge_goals_total")]) == len(MoveItErrorCode)
    assert len(found) < 250
    assert "words" not in "".join(found)
    assert "SECRET" not in "".join(found)


def test_a_scrape_takes_little_of_the_event_loops_time(sources: Sources) -> None:
    exposition = Metrics(sources)
    assert count_calls(lambda: generate_latest(exposition.registry)) < SCRAPE_CALLS


# Goals.


def counted(*goals: tuple[str, int, Performed]) -> dict[tuple[str, ...], float]:
    """Samples after answers to goals: each by its source, its code, and how it was performed."""
    counters = GoalCounters()
    for source, code, performed in goals:
        counters.count(source, Answer(MoveItErrorCode(code), "", performed=performed))
    return samples(counters.collect())


def test_answers_are_counted_by_source_and_code_and_planning_is_timed() -> None:
    found = counted(("/a", 1, NOTHING), ("/a", 1, NOTHING), ("/a", -1, NOTHING), ("/b", 1, NOTHING))
    assert {tuple(labels): value for (name, *labels), value in found.items() if name == "armbridge_goals_total"} == {
        ("/a", "SUCCESS"): 2,
        ("/a", "PLANNING_FAILED"): 1,
        ("/b", "SUCCESS"): 1,
    }
    found = counted(("/a", 99999, NOTHING), ("/a", 1, Performed({}, planning_time_s=0.3)))
    assert found["armbridge_goal_planning_seconds_count",] == 1
    assert found["armbridge_goal_planning_seconds_sum",] == pytest.approx(0.3)
    assert [found["armbridge_goal_planning_seconds_bucket", bound] for bound in ("0.25", "0.5")] == [0, 1]


class Talk:
    """A connection."""

    queued_bytes = 70

    def counts(self) -> TrafficCounts:
        return TrafficCounts(1, 2, 3, 4, 5)


def of_two_clients() -> Traffic:
    traffic = Traffic()
    for _ in range(2):
        traffic.add(Talk())
    return traffic


# Parts of a server, and values by name and labels.
COUNTED: list[tuple[Sources, dict[str, float]]] = [
    (Sources(), {}),
    (Sources(queue=watched.WatchedQueue(2, 1)), {"goals_waiting": 2, "goals_in_hand": 1}),
    (Sources(planners=watched.WatchedPlanners(waiting_count=3)), {"planners_waiting_requests": 3}),
    (Sources(recorder=WatchedRecorder(dropped=4)), {"recording_dropped_messages_total": 4}),
    (Sources(zenoh=WatchedRecorder(dropped=7)), {"zenoh_dropped_messages_total": 7}),
    (
        Sources(of_two_clients()),
        {"clients": 2, "clients_queued_bytes": 140, "connections_total": 2}
        | {"received_messages_total": 2, "received_bytes_total": 4, "sent_messages_total": 6, "sent_bytes_total": 8}
        | {"dropped_messages_total": 10},
    ),
]
OF_ARM: dict[str, float] = {
    "bus_timeouts_total": 10,
    "bus_retries_total": 12,
    "arm_loop_lateness_seconds p99": 0.001,
} | {"bus_round_trip_seconds max": 0.005, "servo_temperature_celsius shoulder_pan": 31}


def test_each_part_is_counted_by_what_it_does() -> None:
    for sources, counts in COUNTED:
        found = {" ".join(key): value for key, value in samples(parts.figures(sources)).items()}
        assert found == {f"armbridge_{name}": value for name, value in counts.items()}
    found = {" ".join(key): value for key, value in samples(parts.arm_health_metrics(arm_health())).items()}
    assert {name: found.get(f"armbridge_{name}") for name in OF_ARM} == OF_ARM


def test_the_arms_mode_and_fault_are_ones_among_zeros_and_an_ideal_arm_has_fewer_metrics() -> None:
    found = samples(parts.arm_metrics(arm_state(Mode.FAULT, FaultCode.OVERHEATED)))
    assert [name[1:] for name, value in found.items() if value == 1] == [("fault",), ("overheated",)]
    assert len(found) == len(Mode) + len(FaultCode)
    sound = samples(parts.arm_metrics(arm_state()))
    assert {value for (name, *_), value in sound.items() if name == "armbridge_arm_fault"} == {0}
    joints = tuple(replace(joint, temperature_c=math.nan) for joint in arm_health().joints)
    found = samples(parts.arm_health_metrics(replace(arm_health(), bus=None, joints=joints)))
    assert not [name for name, *_ in found if name.startswith(("armbridge_bus", "armbridge_servo"))]


def ask(port: int, path: str) -> tuple[int, bytes]:
    """Status and body of what is answered over HTTP."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=TIMEOUT_S) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read()


def health(port: int, path: str = "/healthz") -> tuple[int, dict[str, Any]]:
    status, body = ask(port, path)
    return status, json.loads(body)


def metrics(port: int) -> dict[str, float]:
    """The samples of a server, by name and values of labels."""
    return {"/".join(key): value for key, value in samples(parse(ask(port, "/metrics")[1].decode())).items()}


async def test_routes_are_answered_before_any_part_is_there() -> None:
    sources = Sources()
    monitor = Monitor(sources, SystemdNotifier())
    assert set(monitor.routes) == {"healthz", "readyz", "livez", "metrics"}
    assert check_health(sources).reasons == ("the server is starting",)
    monitor.notify_started()
    assert check_health(sources).ready
    monitor.notify_stopping()
    assert check_health(sources).reasons == ("the server is stopping",)


async def test_a_fault_makes_the_server_unready_but_not_dead(served: ServerOnBus, client: ArmClient) -> None:
    port = served.server.port
    # Planners load behind the start, and on a busy machine some of them a second time.
    sound = 200, {"live": True, "ready": True, "reasons": []}
    await asyncio.to_thread(wait_until, lambda: health(port) == sound)
    await client.call("/arm/emergency_stop")
    await client.until("/arm/state", lambda states: "fault" in values_of(states[-1]))
    status, faulty = await asyncio.to_thread(health, port)
    assert (status, faulty["reasons"]) == (503, ["the arm has a fault: emergency_stop"])
    assert (await asyncio.to_thread(ask, port, "/readyz"))[0] == 503
    assert (await asyncio.to_thread(ask, port, "/livez"))[0] == 200
    assert (await asyncio.to_thread(metrics, port))["armbridge_arm_fault/emergency_stop"] == 1


async def test_metrics_follow_what_happens(served: ServerOnBus, client: ArmClient) -> None:
    port = served.server.port
    # The arm reports on its bus once a second.
    await client.until("/diagnostics", lambda arrays: len(arrays[-1]["status"]) > 1)
    before = await asyncio.to_thread(metrics, port)
    # Its answer comes after all that was sent before.
    await client.call("/rosapi/get_time")
    heard = len(await client.until("/joint_states", bool))
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "nowhere"})
    await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "home"})
    await client.until("/moveit_goal_result", lambda answers: len(answers) == 2)
    await client.until("/joint_states", lambda states: len(states) > heard + 10)
    after = await asyncio.to_thread(metrics, port)
    grown = {name: value - before.get(name, 0.0) for name, value in after.items()}
    assert grown["armbridge_goals_total/SUCCESS//moveit_goal_named"] == 1
    assert sum(value for name, value in grown.items() if name.startswith("armbridge_goals_total")) == 2
    assert grown["armbridge_received_messages_total"] >= 4
    assert grown["armbridge_sent_messages_total"] > 12
    assert after["armbridge_bus_replies_total"] > 100
    assert after["armbridge_clients"] >= 1
    assert after["armbridge_servo_temperature_celsius/gripper"] > 0
    assert after["armbridge_process_resident_memory_bytes"] > 1e6


WELL = Health(live=True, ready=True)
DEAD = Health(live=False, ready=False, reasons=("the arm process has been silent",))


class Listening(SystemdNotifier):
    """A notifier that keeps its notifications."""

    def __init__(self, watchdog_s: float = 3.0) -> None:
        super().__init__()
        self.watchdog_s = watchdog_s
        self.heard: list[str] = []

    def notify_watchdog(self) -> None:
        self.heard.append("alive")


def monitored(notifier: Listening, health: Health, times_s: Iterable[float]) -> list[str]:
    """What a notifier has heard of a server of some health after looks at these times."""
    monitor = Monitor(Sources(), notifier)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(parts, "check_health", lambda _sources: health)
        for now_s in times_s:
            monitor.check(now_s)
    return notifier.heard


def test_signs_of_life_come_in_time_from_a_server_that_lives() -> None:
    heard = monitored(Listening(watchdog_s=3.0), WELL, times_s=(100.0 + 0.25 * tick for tick in range(13)))
    assert heard == ["alive"] * (1 + int(parts.WATCHDOG_NOTIFICATIONS))
    assert monitored(Listening(), DEAD, times_s=range(100, 130)) == []
    assert monitored(Listening(watchdog_s=0.0), WELL, times_s=range(5)) == []


@pytest.mark.stepped_time
async def test_a_blocked_event_loop_shows_as_its_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, SteppedLoop)
    monkeypatch.setattr(parts, "time", SimpleNamespace(monotonic=loop.time))
    monitor = Monitor(Sources(), Listening(), period_s=0.01)
    lag_s = monitor.metrics.loop_lag_s
    watching = asyncio.create_task(monitor.run())
    await asyncio.sleep(0.055)
    name = "armbridge_event_loop_lag_seconds"
    assert samples(lag_s.collect())[f"{name}_sum",] == pytest.approx(0.0)
    loop.advance(0.1)
    await asyncio.sleep(0.02)
    watching.cancel()
    # The look that was due 5 ms later came when the loop was free again.
    assert samples(lag_s.collect())[f"{name}_sum",] == pytest.approx(0.095)
    assert samples(lag_s.collect())[f"{name}_count",] == 7


async def test_metrics_are_text_of_prometheus() -> None:
    answer = await Monitor(Sources(), SystemdNotifier()).routes["metrics"](Request("/metrics", Headers()))
    assert answer.headers["Content-Type"].startswith("text/plain; version=")
    assert any(family.name == "armbridge_live" for family in parse(answer.body.decode()))


PAGE = ROOT / "docs" / "operations.md"


def test_every_metric_is_on_the_page_with_its_kind_and_labels() -> None:
    rows = (re.split(r" *\| *", line)[1:-1] for line in PAGE.read_text().splitlines() if line.startswith("| "))
    told = {
        name: (cells[1], set(filter(None, re.split(r",? +", cells[2].strip()))))
        for cells in rows
        for name in re.findall(r"`(armbridge_\w+)`", cells[0])
    }
    found = {}
    # Of no age, whatever the time is.
    condition = replace(arm_health(), monotonic_s=math.inf)
    for family in Metrics(replace(watched.watched_sources(), arm_health=condition)).registry.collect():
        labels = {label for each in family.samples for label in each.labels} - {"le"}
        # Nobody has sent a goal.
        labels |= {"source", "result"} if family.name == "armbridge_goals" else set()
        found[family.name + ("_total" if family.type == "counter" else "")] = (family.type, labels)
    assert told == found


def test_prometheus_can_read_what_it_is_to_scrape() -> None:
    yaml = pytest.importorskip("yaml")
    (snippet,) = blocks(PAGE, "yaml")
    (job,) = yaml.safe_load(snippet)["scrape_configs"]
    assert job["static_configs"] == [{"targets": ["127.0.0.1:9090"]}]
    with_token = yaml.safe_load(re.sub(r"# (?=authorization|  credentials)", "", snippet))
    assert set(with_token["scrape_configs"][0]["authorization"]) == {"credentials_file"}
