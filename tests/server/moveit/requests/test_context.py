from __future__ import annotations

import math

import pytest

from planners.problem import MoveItErrorCode
from robot.description.forward_kinematics import ForwardPlacements
from server.errors import RefusedError
from server.moveit.poses import pose_of
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import ROBOT, TIP, assert_refused, context, message, near, point


def pose(x, y, z):
    return message("geometry_msgs/Pose", **point(x, y, z))


def test_an_empty_link_is_the_configured_one_of_the_configured_group_only() -> None:
    assert context(end_effector_link="wrist_link").link("") == "wrist_link"
    assert context(group="gripper", end_effector_link="wrist_link").link("") == "moving_jaw_so101_v1_link"


def test_an_unknown_link_is_named_with_those_that_exist() -> None:
    with pytest.raises(RefusedError) as raised:
        context().link("elbow")
    assert_refused(raised.value.failure, MoveItErrorCode.INVALID_LINK_NAME, "'elbow'", TIP)


def test_a_pose_in_a_link_is_placed_by_where_the_link_is_at_the_start() -> None:
    start_rad = HOME | {"shoulder_pan": 0.5 * math.pi}
    expected = pose_of(ForwardPlacements(ROBOT).transforms(start_rad)[TIP])
    assert near(context(start_rad=start_rad).placed(TIP, pose(0.0, 0.0, 0.0), "pose"), expected.position_m)
