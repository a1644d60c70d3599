from planners.geometry.collision import CollidingPair
from planners.goals import ConstraintGoal, Constraints, PositionGoal
from planners.ik.goal_refusals import (
    goal_in_collision,
    out_of_time,
)
from planners.problem import Deviation, MoveItErrorCode, PlanningFailure

TIP = "gripper_frame_link"
POINT = PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)


def test_collision_names_links_and_objects_with_depth():
    pair = CollidingPair("gripper_link", "mug", 0.011, point_m=(0.2, 0.0, 0.1), normal=(0.0, 0.0, 1.0))
    failure = goal_in_collision([pair])
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert "gripper_link and mug by 11.0 mm" in failure.message
    said = {"first": "gripper_link", "second": "mug", "depth_m": 0.011}
    assert failure.details["pairs"] == [said | {"point_m": (0.2, 0.0, 0.1), "normal": (0.0, 0.0, 1.0)}]


def test_a_timeout_tells_how_near_the_search_came():
    late = PlanningFailure(MoveItErrorCode.TIMED_OUT, "too late", {"allowed_time_s": 0.01})
    failure = out_of_time(POINT, late, (0.25, 0.0, 0.2), Deviation(0.05))
    assert failure.code is MoveItErrorCode.TIMED_OUT
    assert "5.0 cm" in failure.message
    assert failure.details == {"allowed_time_s": 0.01, "nearest_m": [0.25, 0.0, 0.2], "distance_m": 0.05}
    assert out_of_time(ConstraintGoal(Constraints()), late, (0.0, 0.0, 0.0), Deviation()) is late
