import dataclasses
import json
from dataclasses import replace
from typing import Any

import pytest

from robot.faults import FaultCode
from robot.messages import Mode
from server.monitoring.health import ARM_SILENT_S, ARM_STALE_S, Sources, check_health
from tests.server.monitoring.watched_parts import (
    WatchedArm,
    WatchedPlanners,
    WatchedRecorder,
    arm_state,
    watched_sources,
)


@pytest.fixture
def sources() -> Sources:
    return watched_sources()


def test_a_server_at_work_is_live_and_ready_and_has_nothing_to_say(sources: Sources) -> None:
    # The second arm is simulated, and starved by a busy machine.
    for arm in (sources.arm, WatchedArm(arm_state(), 4.9, state_max_age_s=5.0)):
        health = check_health(replace(sources, arm=arm))
        assert (health.live, health.ready, health.reasons, health.warnings) == (True, True, (), ())


NOT_READY: dict[str, tuple[dict[str, Any], str]] = {
    "no part": (dataclasses.asdict(Sources()), "the server is starting"),
    "start": ({"started": False}, "the server is starting"),
    "stop": ({"stopping": True}, "the server is stopping"),
    "no bus": ({"arm": WatchedArm(arm_state(Mode.DISCONNECTED))}, "the arm is not connected"),
    "checks": ({"arm": WatchedArm(arm_state(Mode.CONNECTED))}, "the servos are being checked, or were refused"),
    "fault": ({"arm": WatchedArm(arm_state(Mode.FAULT, FaultCode.OVERHEATED))}, "the arm has a fault: overheated"),
    "stale": ({"arm": WatchedArm(arm_state(), ARM_STALE_S + 0.1)}, "the last state of the arm is older than 1.5 s"),
    "stale simulation": (
        {"arm": WatchedArm(arm_state(), 5.1, state_max_age_s=5.0)},
        "the last state of the arm is older than 5 s",
    ),
    "planners load": ({"planners": WatchedPlanners(loaded_count=0)}, "the planners are loading"),
    "planners fail": (
        {"planners": WatchedPlanners(load_failure="no module in /home/me")},
        "the planners cannot be started",
    ),
}


@pytest.mark.parametrize(("changes", "reason"), NOT_READY.values(), ids=NOT_READY.keys())
def test_an_obstacle_to_goals_is_a_reason_to_be_unready(sources: Sources, changes: dict[str, Any], reason: str) -> None:
    health = check_health(replace(sources, **changes))
    assert (health.live, health.ready, health.reasons) == (True, False, (reason,))


def test_an_arm_process_that_is_silent_for_long_makes_the_server_dead(sources: Sources) -> None:
    sources.arm = WatchedArm(arm_state(), ARM_SILENT_S + 0.1)
    health = check_health(sources)
    assert (health.live, health.ready) == (False, False)
    assert health.reasons == ("the arm process has been silent for more than 10 s",)


@pytest.mark.parametrize("changes", [{"started": False}, {"stopping": True}])
def test_at_start_and_end_a_silent_arm_process_is_no_death(sources: Sources, changes: dict[str, bool]) -> None:
    sources.arm = WatchedArm(arm_state(), ARM_SILENT_S + 0.1)
    assert check_health(replace(sources, **changes)).live


WARNINGS: dict[str, tuple[dict[str, Any], str]] = {
    "relaxed": ({"arm": WatchedArm(arm_state(Mode.RELAXED))}, "relaxed"),
    "recording ended": ({"recorder": WatchedRecorder(ended=True)}, "the recording has ended"),
    "recording has gaps": ({"recorder": WatchedRecorder(dropped=1)}, "messages are missing"),
}


@pytest.mark.parametrize(("changes", "words"), WARNINGS.values(), ids=WARNINGS.keys())
def test_a_harmless_condition_is_a_warning(sources: Sources, changes: dict[str, Any], words: str) -> None:
    health = check_health(replace(sources, **changes))
    assert health.ready
    (warning,) = health.warnings
    assert words in warning


def test_strangers_hear_of_no_device_file_or_address(sources: Sources) -> None:
    sources.arm = WatchedArm(arm_state(Mode.DISCONNECTED, FaultCode.BUS_LOST, "no /dev/ttySECRET"))
    sources.planners = WatchedPlanners(load_failure="cannot read /home/SECRET")
    assert b"SECRET" not in check_health(sources).response(good=False).body


def test_the_answer_over_http_has_the_status_that_monitors_look_at(sources: Sources) -> None:
    health = check_health(replace(sources, started=False))
    assert [int(health.response(good=good).status) for good in (True, False)] == [200, 503]
    told = {"live": True, "ready": False, "reasons": ["the server is starting"], "warnings": []}
    assert json.loads(health.response(good=False).body) == told


# Sources.


def test_children_are_those_that_run() -> None:
    assert Sources().children() == {}
    sources = Sources(arm=WatchedArm(arm_state(), pids=(11,)), planners=WatchedPlanners(pids=(21, 22)))
    assert sources.children() == {"arm": 11, "planner_1": 21, "planner_2": 22}
    sources.arm = WatchedArm(arm_state(), pids=())
    assert sources.children() == {"planner_1": 21, "planner_2": 22}
    sources.arm = WatchedArm(arm_state(), pids=(11, 12))
    assert sources.children() == {"arm_1": 11, "arm_2": 12, "planner_1": 21, "planner_2": 22}
