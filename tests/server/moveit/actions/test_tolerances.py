from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.problem import PlanningFailure
from server.moveit.actions.joint_trajectory_controller import tolerances_of, violated
from tests.helpers.moveit_requests import message
from tests.helpers.played_arm import JOINTS, PlayedArm

STATE = replace(PlayedArm().state, position_rad=np.full(len(JOINTS), 0.1))
WANTED = dict.fromkeys(JOINTS, 0.0)


def read(name: str, position_rad: float) -> object:
    tolerance = message("control_msgs/msg/JointTolerance", name=name, position=position_rad)
    return tolerances_of([tolerance], "path_tolerance", JOINTS)


@pytest.mark.parametrize(("position_rad", "demanded"), [(0.05, {"elbow_flex": 0.05}), (0.0, {}), (-1.0, {})])
def test_only_a_positive_tolerance_demands_anything(position_rad: float, demanded: dict[str, float]) -> None:
    assert read("elbow_flex", position_rad) == demanded


@pytest.mark.parametrize(("name", "position_rad", "word"), [("knee", 0.1, "'knee'"), ("elbow_flex", math.nan, "nan")])
def test_a_wrong_tolerance_is_refused_with_its_field(name: str, position_rad: float, word: str) -> None:
    refused = read(name, position_rad)
    assert isinstance(refused, PlanningFailure)
    assert refused.message.startswith("path_tolerance")
    assert word in refused.message


def test_the_joint_that_is_too_far_away_is_named_with_its_numbers() -> None:
    assert violated({"elbow_flex": 0.2}, STATE, WANTED) == ""
    sentence = violated({"elbow_flex": 0.05}, STATE, WANTED)
    assert sentence == "joint elbow_flex is 0.100 rad from where it should be (tolerance 0.05 rad)"


def test_an_arm_that_is_not_read_violates_nothing() -> None:
    assert violated({"elbow_flex": 0.05}, replace(STATE, position_rad=None), WANTED) == ""
