from __future__ import annotations

from typing import Any

import pytest

from robot.description import model
from server.moveit.suggestions import suggestion

ROBOT = model.builtin()


def test_a_joint_goal_beyond_limits_is_brought_within_them_in_every_joint() -> None:
    asked = {"name": ["shoulder_pan", "elbow_flex", "knee"], "position": [9.0, 0.2, 1.0]}
    found = suggestion(asked, {"joint": "shoulder_pan", "lower_rad": -1.0, "upper_rad": 1.0}, ROBOT)
    assert found is not None
    assert found.topic == "/moveit_goal_joints"
    assert found.msg == {"name": ["shoulder_pan", "elbow_flex"], "position": [ROBOT.joints["shoulder_pan"].upper, 0.2]}


@pytest.mark.parametrize("key", ["nearest_m", "free_m"])
def test_a_point_is_suggested_in_the_planning_frame(key: str) -> None:
    found = suggestion({}, {key: [0.1, 0.2, 0.3]}, ROBOT)
    assert found is not None
    assert found.topic == "/moveit_goal_pose"
    assert found.msg["header"]["frame_id"] == ROBOT.root_link
    assert found.msg["pose"]["position"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert "(0.100, 0.200, 0.300) m" in found.words


def test_a_free_configuration_is_suggested_joint_by_joint() -> None:
    found = suggestion({}, {"free_rad": {"elbow_flex": 0.25}}, ROBOT)
    assert found is not None
    assert found.as_data() == {
        "topic": "/moveit_goal_joints",
        "type": "sensor_msgs/JointState",
        "msg": {"name": ["elbow_flex"], "position": [0.25]},
    }


@pytest.mark.parametrize(
    "details", [{}, {"joint": "shoulder_pan"}, {"joint": "shoulder_pan", "lower_rad": 0.0, "upper_rad": 1.0}]
)
def test_without_a_finding_nothing_is_suggested(details: dict[str, Any]) -> None:
    assert suggestion({"data": "home"}, details, ROBOT) is None
