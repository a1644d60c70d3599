"""``/compute_cartesian_path``."""

import math
from typing import Any

from planners.problem import MoveItErrorCode
from tests.helpers.moveit import ServiceRig, point

NEAR, FAR = point(0.33, 0.0, 0.2, w=1.0), point(0.33, 0.6, 0.2, w=1.0)


async def path(rig: ServiceRig, *waypoints: Any, max_step: float = 0.01, **fields: Any) -> Any:
    return await rig.call("/compute_cartesian_path", waypoints=list(waypoints or [NEAR]), max_step=max_step, **fields)


async def test_a_path_that_is_followed_in_part_says_how_far_and_ends_at_contacts_to_be_avoided(rig: ServiceRig) -> None:
    answer = await path(rig, NEAR, FAR)
    assert 0.0 < answer["fraction"] < 1.0
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "cm" in answer["error_code"]["message"]
    assert answer["solution"]["joint_trajectory"]["points"]
    shown = rig.listen("/display_contacts", "visualization_msgs/MarkerArray")
    into_itself = point(0.0, 0.0, 0.1, w=1.0)
    blind, careful = await path(rig, into_itself), await path(rig, into_itself, avoid_collisions=True)
    assert careful["fraction"] < blind["fraction"]
    assert careful["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "touch" in careful["error_code"]["message"]
    assert len(shown[-1]["markers"]) > 1


async def test_speeds_are_kept_but_of_a_link_that_does_not_follow_the_path(rig: ServiceRig) -> None:
    fields = {"max_velocity_scaling_factor": 0.4, "max_acceleration_scaling_factor": 0.3, "max_cartesian_speed": 0.05}
    await path(rig, **fields)
    problem: Any = rig.pool.requests[-1]
    assert (problem.velocity_scaling, problem.acceleration_scaling, problem.tip_speed_m_s) == (0.4, 0.3, 0.05)
    answer = await path(rig, max_cartesian_speed=0.05, cartesian_speed_limited_link="wrist_link")
    assert "wrist_link" in answer["error_code"]["message"]


async def test_a_joint_that_races_more_than_allowed_ends_the_path_before_it(rig: ServiceRig) -> None:
    # Towards the end the arm is stretched, and its elbow races.
    bent = {"joint_state": {"name": ["shoulder_lift", "elbow_flex"], "position": [-1.2, 1.4]}}
    stretching = {"start_state": bent, "max_step": 0.02}
    stretched = {**point(0.45, 0.0, 0.226), "orientation": {"y": 0.7071, "w": 0.7071}}
    for none in (0.0, -0.1):
        assert (await path(rig, stretched, revolute_jump_threshold=none, **stretching))["fraction"] == 1.0
    answer = await path(rig, stretched, revolute_jump_threshold=0.006, **stretching)
    assert 0.5 < answer["fraction"] < 0.95
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    for words in ("'elbow_flex' would jump", "of 21.4 cm"):
        assert words in answer["error_code"]["message"]
    assert answer["solution"]["joint_trajectory"]["points"]


async def test_a_path_that_cannot_be_begun_has_its_code_and_a_sentence(rig: ServiceRig) -> None:
    for fields, code, words in (
        *(({"max_step": step}, 99999, "max_step") for step in (0.0, -0.1, math.nan)),
        ({"group_name": "manipulator"}, -15, "'manipulator'"),
        ({"link_name": "hand"}, -18, "'hand'"),
        ({"header": {"frame_id": "moon"}}, -21, "'moon'"),
        ({"max_velocity_scaling_factor": -1.0}, -16, "max_velocity_scaling_factor"),
        ({"revolute_jump_threshold": math.nan}, -16, "joint step"),
        ({"max_cartesian_speed": math.nan}, -16, "max_cartesian_speed"),
        ({"waypoints": []}, -16, "no segment"),
    ):
        answer = await rig.call("/compute_cartesian_path", **{"waypoints": [NEAR], "max_step": 0.01, **fields})
        assert (answer["error_code"]["val"], answer["fraction"]) == (code, 0.0)
        assert words in answer["error_code"]["message"]
