from __future__ import annotations

from tests.helpers.moveit import context


def test_an_empty_link_is_the_configured_one_of_the_configured_group_only() -> None:
    assert context(end_effector_link="wrist_link").link("") == "wrist_link"
    assert context(group="gripper", end_effector_link="wrist_link").link("") == "moving_jaw_so101_v1_link"
