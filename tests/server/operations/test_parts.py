from __future__ import annotations

from server.operations.parts import Parts
from tests.helpers.watched_parts import WatchedArm, WatchedPlanners, arm_state


def test_children_are_those_that_run() -> None:
    parts = Parts(arm=WatchedArm(arm_state(), pid=11), planners=WatchedPlanners(pids=(21, 22)))
    assert parts.children() == {"arm": 11, "planner_1": 21, "planner_2": 22}
    parts.arm = WatchedArm(arm_state(), pid=None)
    assert parts.children() == {"planner_1": 21, "planner_2": 22}


def test_before_the_start_there_are_none() -> None:
    assert Parts().children() == {}
