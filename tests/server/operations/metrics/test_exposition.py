from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse

from planners.problem import MoveItErrorCode
from robot.faults import FaultCode
from server.gateway.connection import Traffic
from server.goal_queue import Answer
from server.operations.distribution import Distribution
from server.operations.goal_tally import GoalTally
from server.operations.metrics.exposition import CONDITION_STALE_S, Exposition
from server.operations.parts import Parts
from tests.helpers.watched_parts import (
    WatchedArm,
    WatchedPlanners,
    WatchedQueue,
    WatchedRecorder,
    arm_health,
    arm_state,
)

# A scrape holds the event loop up for so long at most [s of processor time].
SCRAPE_S = 0.005


@pytest.fixture
def parts() -> Parts:
    return Parts(
        traffic=Traffic(),
        goal_tally=GoalTally(),
        queue=WatchedQueue(),
        arm=WatchedArm(arm_state()),
        arm_health=arm_health(),
        planners=WatchedPlanners(),
        recorder=WatchedRecorder(),
        started=True,
    )


def samples(parts: Parts) -> Mapping[str, float]:
    """Every sample by its name and labels."""
    text = Exposition(parts, Distribution((0.1,))).expose("").text.decode()
    found: dict[str, float] = {}
    for family in parse(text):
        for each in family.samples:
            labels = ",".join(f"{key}={value}" for key, value in sorted(each.labels.items()))
            key = f"{each.name}{{{labels}}}" if labels else each.name
            assert key not in found
            found[key] = each.value
    return found


def test_every_part_is_in_the_text(parts: Parts) -> None:
    found = samples(parts)
    assert found["armbridge_live"] == found["armbridge_ready"] == 1
    assert found["armbridge_clients"] == 0
    assert found["armbridge_goals_waiting"] == 2
    assert found["armbridge_planners_waiting_requests"] == 3
    assert found["armbridge_recording"] == 1
    assert found["armbridge_servo_temperature_celsius{joint=gripper}"] == 32
    assert found["armbridge_process_threads{process=server}"] >= 1


def test_what_is_not_there_yet_has_no_metrics() -> None:
    found = samples(Parts())
    assert found["armbridge_ready"] == 0
    assert not [name for name in found if "servo" in name or "client" in name or "goal" in name]


def test_an_old_condition_is_not_told_as_if_it_were_the_present_one(parts: Parts) -> None:
    assert parts.arm_health is not None
    parts.arm_health = replace(parts.arm_health, stamp_s=time.time() - CONDITION_STALE_S - 1.0)
    assert not [name for name in samples(parts) if name.startswith(("armbridge_servo", "armbridge_bus"))]


def test_a_slow_simulated_arm_tells_its_condition_as_seldom_as_its_time_passes(parts: Parts) -> None:
    assert parts.arm_health is not None
    stamp_s = time.time() - CONDITION_STALE_S - 1.0
    parts.arm_health = replace(parts.arm_health, stamp_s=stamp_s, real_time_factor=0.25)
    assert samples(parts)["armbridge_arm_real_time_factor"] == 0.25


def test_both_formats_can_be_read(parts: Parts) -> None:
    text = Exposition(parts, Distribution((0.1,))).expose("application/openmetrics-text").text.decode()
    names = {family.name for family in parse_openmetrics(text)}
    assert {"armbridge_goals", "armbridge_build"} <= names


def test_names_keep_to_the_conventions(parts: Parts) -> None:
    text = Exposition(parts, Distribution((0.1,))).expose("").text.decode()
    for family in parse(text):
        assert family.name.startswith("armbridge_")
        assert family.documentation.endswith(".")
        assert not family.name.endswith(("_ms", "_mb", "_percent", "_total"))


def test_nothing_that_strangers_choose_becomes_a_label(parts: Parts) -> None:
    """However long the server runs, there are no more series than joints, faults, processes and results."""
    assert parts.goal_tally is not None
    for code in MoveItErrorCode:
        parts.goal_tally.take("/moveit_goal_pose", Answer(code, "words of a client"))
    parts.arm = WatchedArm(arm_state(fault=FaultCode.OVERHEATED))
    found = samples(parts)
    assert len([name for name in found if name.startswith("armbridge_goals_total")]) == len(MoveItErrorCode)
    assert len(found) < 250
    assert "words" not in "".join(found)
    assert "SECRET" not in "".join(found)


def test_a_scrape_takes_little_of_the_event_loops_time(parts: Parts) -> None:
    exposition = Exposition(parts, Distribution((0.1,)))
    exposition.expose("")
    took_s = []
    for _ in range(5):
        began_s = time.thread_time()
        exposition.expose("")
        took_s.append(time.thread_time() - began_s)
    assert min(took_s) < SCRAPE_S
