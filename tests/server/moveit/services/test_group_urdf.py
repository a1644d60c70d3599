from __future__ import annotations

import pytest

from planners.problem import MoveItErrorCode
from robot import model
from server.moveit.services.move_group_services import group_urdf
from tests.helpers.moveit_requests import ROBOT
from tests.helpers.moveit_services import ServiceRig


@pytest.mark.parametrize("name", ["arm", "gripper"])
def test_a_groups_urdf_is_a_robot_with_its_joints(name: str) -> None:
    group = ROBOT.groups[name]
    chain = f'<chain base_link="{group.base_link}" tip_link="{group.tip_link}"/>'
    srdf = f'<robot name="{name}"><group name="{name}">{chain}</group></robot>'
    part = model.parse(group_urdf(ROBOT, group), srdf)
    assert part.groups[name].joints == group.joints
    assert part.root_link == group.base_link


def test_links_beside_the_group_are_left_out() -> None:
    assert "moving_jaw" not in group_urdf(ROBOT, ROBOT.groups["arm"])


async def test_an_unknown_group_has_no_urdf() -> None:
    answer = await ServiceRig().call("/get_urdf", group_name="manipulator")
    assert answer["error_code"]["val"] == MoveItErrorCode.INVALID_GROUP_NAME
    assert answer["urdf_string"] == ""


async def test_an_empty_name_is_the_configured_group() -> None:
    answer = await ServiceRig().call("/get_urdf")
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert "gripper_frame_link" in answer["urdf_string"]
