from __future__ import annotations

from server.config import Settings


def test_the_defaults_are_those_of_the_old_goal_node() -> None:
    moveit = Settings().moveit
    assert (moveit.group_name, moveit.num_planning_attempts, moveit.allowed_planning_time) == ("arm", 5, 5.0)
    assert (moveit.max_velocity_scaling, moveit.max_acceleration_scaling) == (0.3, 0.3)
    assert (moveit.position_tolerance, moveit.joint_tolerance) == (0.01, 0.01)
