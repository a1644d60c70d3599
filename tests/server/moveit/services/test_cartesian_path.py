"""``/compute_cartesian_path``."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.problem import Line, MoveItErrorCode
from planners.scene import Pose
from robot.trajectory import Trajectory
from server.moveit.services.cartesian_path import cut_lines, first_jump, length_m
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import FORWARD, TIP, ServiceRig, point
from tests.helpers.resources import examples

NEAR, FAR = point(0.33, 0.0, 0.2, w=1.0), point(0.33, 0.6, 0.2, w=1.0)


async def path(rig: ServiceRig, *waypoints: Any, max_step: float = 0.01, **fields: Any) -> Any:
    return await rig.call("/compute_cartesian_path", waypoints=list(waypoints or [NEAR]), max_step=max_step, **fields)


async def test_a_path_that_can_be_followed_in_part_says_how_far_and_why(rig: ServiceRig) -> None:
    answer = await path(rig, NEAR, FAR)
    assert 0.0 < answer["fraction"] < 1.0
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "cm" in answer["error_code"]["message"]
    assert answer["solution"]["joint_trajectory"]["points"]


async def test_speeds_are_kept_but_of_a_link_that_does_not_follow_the_path(rig: ServiceRig) -> None:
    fields = {"max_velocity_scaling_factor": 0.4, "max_acceleration_scaling_factor": 0.3, "max_cartesian_speed": 0.05}
    await path(rig, **fields)
    problem: Any = rig.pool.requests[-1]
    assert (problem.velocity_scaling, problem.acceleration_scaling, problem.tip_speed_m_s) == (0.4, 0.3, 0.05)
    answer = await path(rig, max_cartesian_speed=0.05, cartesian_speed_limited_link="wrist_link")
    assert "wrist_link" in answer["error_code"]["message"]


async def test_a_greater_step_of_a_joint_than_allowed_ends_the_path_before_it(rig: ServiceRig) -> None:
    # Towards the end the arm is stretched, and its elbow races.
    bent = {"joint_state": {"name": ["shoulder_lift", "elbow_flex"], "position": [-1.2, 1.4]}}
    stretching = {"start_state": bent, "max_step": 0.02}
    stretched = {**point(0.45, 0.0, 0.226), "orientation": {"y": 0.7071, "w": 0.7071}}
    assert (await path(rig, stretched, **stretching))["fraction"] == 1.0
    answer = await path(rig, stretched, revolute_jump_threshold=0.3, **stretching)
    assert 0.5 < answer["fraction"] < 0.95
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    for words in ("of 21.4 cm", "'elbow_flex' would jump", "step of 20 mm"):
        assert words in answer["error_code"]["message"]
    assert answer["solution"]["joint_trajectory"]["points"]


async def test_a_factor_that_no_step_exceeds_changes_nothing(rig: ServiceRig) -> None:
    assert (await path(rig, jump_threshold=1.57))["fraction"] == 1.0
    assert len(rig.pool.requests) == 1


async def test_contacts_end_the_path_when_they_are_to_be_avoided(rig: ServiceRig) -> None:
    shown = rig.listen("/display_contacts", "visualization_msgs/MarkerArray")
    into_itself = point(0.0, 0.0, 0.1, w=1.0)
    blind, careful = await path(rig, into_itself), await path(rig, into_itself, avoid_collisions=True)
    assert careful["fraction"] < blind["fraction"]
    assert careful["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "touch" in careful["error_code"]["message"]
    assert len(shown[-1]["markers"]) > 1


BAD = [
    *(({"max_step": step}, 99999, "max_step") for step in (0.0, -0.1, math.nan)),
    ({"group_name": "manipulator"}, -15, "'manipulator'"),
    ({"link_name": "hand"}, -18, "'hand'"),
    ({"header": {"frame_id": "moon"}}, -21, "'moon'"),
    ({"max_velocity_scaling_factor": -1.0}, -16, "max_velocity_scaling_factor"),
    ({"jump_threshold": math.nan}, -16, "jump_threshold"),
    ({"max_cartesian_speed": math.nan}, -16, "max_cartesian_speed"),
    ({"waypoints": []}, -16, "no segment"),
]


@pytest.mark.parametrize(("fields", "code", "words"), BAD)
async def test_a_path_that_cannot_be_begun_has_its_code_and_a_sentence(rig: ServiceRig, fields, code, words) -> None:
    answer = await rig.call("/compute_cartesian_path", **{"waypoints": [NEAR], "max_step": 0.01, **fields})
    assert (answer["error_code"]["val"], answer["fraction"]) == (code, 0.0)
    assert words in answer["error_code"]["message"]


HALF = math.sqrt(0.5)
START = Pose()
ALONG_X = Line(Pose((0.3, 0.0, 0.0)))
THEN_Y = Line(Pose((0.3, 0.4, 0.0), (0.0, 0.0, 1.0, 0.0)))


@examples(50)
@given(st.floats(0.0, 0.7))
def test_a_cut_path_has_the_length_to_keep(along_m: float) -> None:
    assert length_m(START, cut_lines(START, [ALONG_X, THEN_Y], along_m)) == pytest.approx(along_m, abs=1e-12)


def test_a_cut_path_turns_the_shorter_way_and_ends_at_its_end() -> None:
    flipped = Line(Pose((1.0, 0.0, 0.0), (0.0, 0.0, -HALF, -HALF)))
    (half,) = cut_lines(START, [flipped], 0.5)
    assert abs(np.dot(half.end.orientation, (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8)))) > 1.0 - 1e-9
    assert cut_lines(START, [ALONG_X, THEN_Y], 9.0) == (ALONG_X, THEN_Y)


def panned(*angles_rad: float, duration_s: float = 1.0) -> Trajectory:
    """The shoulder turns: the tip goes round on a circle of 0.35 m."""
    times = np.linspace(0.0, duration_s, len(angles_rad))
    positions = np.array(angles_rad)[:, np.newaxis]
    speeds = np.gradient(positions[:, 0], times)[:, np.newaxis] if len(times) > 1 else np.zeros((1, 1))
    return Trajectory(("shoulder_pan",), times, positions, speeds, np.zeros_like(positions))


def jump(motion, step_m=0.05, step_rad=0.0, factor=0.0):
    return first_jump(motion, (FORWARD, TIP), HOME, step_m, (step_rad, factor))


EVEN = panned(*np.linspace(0.0, 1.0, 20))


def test_a_step_is_what_joints_do_while_the_tip_moves_by_a_length() -> None:
    radius_m = math.hypot(*FORWARD.transforms(HOME)[TIP][:2, 3] - FORWARD.transforms(HOME)["shoulder_link"][:2, 3])
    expected_rad = 0.05 / radius_m
    assert jump(EVEN, step_rad=1.02 * expected_rad) is None
    found = jump(EVEN, step_rad=0.98 * expected_rad)
    assert found is not None
    assert found.joint == "shoulder_pan"
    assert found.step_rad == pytest.approx(expected_rad, rel=0.01)


def test_nothing_jumps_without_thresholds_evenly_or_at_rest() -> None:
    assert jump(EVEN) is None
    assert jump(EVEN, step_m=0.1, factor=1.2) is None
    assert jump(panned(0.3), step_rad=0.01, factor=1.0) is None
