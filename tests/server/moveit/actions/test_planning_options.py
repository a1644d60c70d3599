from __future__ import annotations

import math
from typing import Any

import pytest

from planners.problem import PlanningFailure
from server.moveit.actions.move_group import DEFAULT_ATTEMPTS, MAX_ATTEMPTS, Options, options_of
from tests.helpers.moveit_requests import message


def options(**fields: Any) -> Options:
    read = options_of(message("moveit_msgs/msg/PlanningOptions", **fields))
    assert isinstance(read, Options)
    return read


def test_what_is_left_out_means_one_attempt_in_the_present_scene() -> None:
    assert options() == Options(plan_only=False, attempts=1, delay_s=0.0, scene_diff=None, warnings=())


@pytest.mark.parametrize(
    ("asked", "attempts"), [(0, DEFAULT_ATTEMPTS), (-1, DEFAULT_ATTEMPTS), (3, 3), (100_000, MAX_ATTEMPTS)]
)
def test_planning_anew_has_moveits_default_and_a_bound(asked: int, attempts: int) -> None:
    assert options(replan=True, replan_attempts=asked).attempts == attempts


@pytest.mark.parametrize("delay_s", [-1.0, 11.0, math.nan, math.inf])
def test_a_delay_that_nobody_waits_for_is_refused_with_its_limit(delay_s: float) -> None:
    read = options_of(message("moveit_msgs/msg/PlanningOptions", replan_delay=delay_s))
    assert isinstance(read, PlanningFailure)
    assert "replan_delay must be from 0 to 10 s" in read.message


def test_an_object_in_the_scene_diff_is_kept_as_a_difference() -> None:
    diff = options(planning_scene_diff={"world": {"collision_objects": [{"id": "box"}]}}).scene_diff
    assert diff is not None
    assert diff["is_diff"]
    assert diff["world"]["collision_objects"][0]["id"] == "box"


def test_looking_around_is_ignored_and_told() -> None:
    assert "look_around" in options(look_around=True).warnings[0]
