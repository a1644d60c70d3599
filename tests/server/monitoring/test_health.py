import dataclasses
import json
from dataclasses import replace
from typing import Any

import pytest

from robot.faults import FaultCode
from robot.messages import Mode
from server.monitoring.health import ARM_SILENT_S, ARM_STALE_S, Sources, check_health
from tests.server.monitoring import watched_parts
from tests.server.monitoring.watched_parts import WatchedArm, WatchedPlanners, WatchedRecorder, arm_state


@pytest.fixture
def sources() -> Sources:
    return watched_parts.watched_sources()


def test_a_server_at_work_is_live_and_ready_and_has_nothing_to_say(sources: Sources) -> None:
    # The second arm is simulated, and starved by a busy machine.
    for arm in (sources.arm, WatchedArm(arm_state(), 4.9, state_max_age_s=5.0)):
        health = check_health(replace(sources, arm=arm))
        assert (health.live, health.ready, health.reasons, health.warnings) == (True, True, (), ())


NOT_READY: list[tuple[dict[str, Any], str]] = [
    (dataclasses.asdict(Sources()), "the server is starting"),
    ({"started": False}, "the server is starting"),
    ({"stopping": True}, "the server is stopping"),
    ({"arm": WatchedArm(arm_state(Mode.DISCONNECTED))}, "the arm is not connected"),
    ({"arm": WatchedArm(arm_state(Mode.CONNECTED))}, "the servos are being checked, or were refused"),
    ({"arm": WatchedArm(arm_state(Mode.FAULT, FaultCode.OVERHEATED))}, "the arm has a fault: overheated"),
    ({"arm": WatchedArm(arm_state(), ARM_STALE_S + 0.1)}, "the last state of the arm is older than 1.5 s"),
    ({"arm": WatchedArm(arm_state(), 5.1, state_max_age_s=5.0)}, "the last state of the arm is older than 5 s"),
    ({"planners": WatchedPlanners(loaded_count=0)}, "the planners are loading"),
    ({"planners": WatchedPlanners(load_failure="no module in /home/me")}, "the planners cannot be started"),
]


def test_an_obstacle_to_goals_is_a_reason_to_be_unready(sources: Sources) -> None:
    for changes, reason in NOT_READY:
        health = check_health(replace(sources, **changes))
        assert (health.live, health.ready, health.reasons) == (True, False, (reason,)), changes


def test_an_arm_process_that_is_silent_for_long_makes_the_server_dead_unless_it_starts_or_stops(
    sources: Sources,
) -> None:
    sources.arm = WatchedArm(arm_state(), ARM_SILENT_S + 0.1)
    health = check_health(sources)
    reason = "the arm process has been silent for more than 10 s"
    assert (health.live, health.ready, health.reasons) == (False, False, (reason,))
    for changes in ({"started": False}, {"stopping": True}):
        assert check_health(replace(sources, **changes)).live, changes


def test_a_harmless_condition_is_a_warning(sources: Sources) -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"arm": WatchedArm(arm_state(Mode.RELAXED))}, "relaxed"),
        ({"recorder": WatchedRecorder(ended=True)}, "the recording has ended"),
        ({"recorder": WatchedRecorder(dropped=1)}, "messages are missing"),
    ]
    for changes, words in cases:
        health = check_health(replace(sources, **changes))
        (warning,) = health.warnings
        assert (health.ready, words in warning) == (True, True), warning


def test_strangers_hear_of_no_device_file_or_address(sources: Sources) -> None:
    sources.arm = WatchedArm(arm_state(Mode.DISCONNECTED, FaultCode.BUS_LOST, "no /dev/ttySECRET"))
    sources.planners = WatchedPlanners(load_failure="cannot read /home/SECRET")
    assert b"SECRET" not in check_health(sources).response(good=False).body


def test_the_answer_over_http_has_the_status_that_monitors_look_at(sources: Sources) -> None:
    health = check_health(replace(sources, started=False))
    assert [int(health.response(good=good).status) for good in (True, False)] == [200, 503]
    told = {"live": True, "ready": False, "reasons": ["the server is starting"], "warnings": []}
    assert json.loads(health.response(good=False).body) == told


def test_children_are_those_that_run() -> None:
    assert Sources().children() == {}
    for pids, arms in (((11,), {"arm": 11}), ((), {}), ((11, 12), {"arm_1": 11, "arm_2": 12})):
        sources = Sources(arm=WatchedArm(arm_state(), pids=pids), planners=WatchedPlanners(pids=(21, 22)))
        assert sources.children() == {**arms, "planner_1": 21, "planner_2": 22}
