import math

import pytest

from planners.geometry.collision import CollidingPair
from planners.goals import ConstraintGoal, Constraints, PoseGoal, PositionGoal
from planners.ik.constraints import Violation
from planners.ik.goal_refusals import (
    goal_in_collision,
    goal_violates,
    none_of,
    out_of_reach,
    out_of_time,
    start_violates,
)
from planners.problem import Deviation, MoveItErrorCode, PlanningFailure
from planners.scene import Pose

TIP = "gripper_frame_link"
POINT = PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)
POSE = PoseGoal(TIP, Pose((0.3, 0.0, 0.2)), 0.01, (0.1, 0.1, 0.1), strict=True)
VIOLATION = Violation("joint 'a' is at 1 rad, outside 0 to 0.5 rad", {"joint": "a"})


def test_collision_names_links_and_objects_with_depth():
    pair = CollidingPair("gripper_link", "mug", 0.011, point_m=(0.2, 0.0, 0.1), normal=(0.0, 0.0, 1.0))
    failure = goal_in_collision([pair])
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION
    assert "gripper_link and mug by 11.0 mm" in failure.message
    said = {"first": "gripper_link", "second": "mug", "depth_m": 0.011}
    assert failure.details["pairs"] == [said | {"point_m": (0.2, 0.0, 0.1), "normal": (0.0, 0.0, 1.0)}]


@pytest.mark.parametrize(
    ("refusal", "code"),
    [
        (goal_violates, MoveItErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS),
        (start_violates, MoveItErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS),
    ],
)
def test_violations_are_said_and_given_as_data(refusal, code):
    failure = refusal([VIOLATION])
    assert failure.code is code
    assert VIOLATION.sentence in failure.message
    assert failure.details["violations"] == [{"joint": "a"}]


def test_first_alternative_speaks_for_all_and_none_is_lost():
    failures = [PlanningFailure(MoveItErrorCode(code), str(code)) for code in (-31, -12)]
    failure = none_of(failures)
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert [other["code"] for other in failure.details["alternatives"]] == [-31, -12]


def test_point_out_of_reach_is_answered_with_the_nearest_one_and_its_distance():
    failure = out_of_reach(POINT, (0.25, 0.0, 0.2), Deviation(0.05), [])
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert all(said in failure.message for said in ("(0.3, 0, 0.2) m", "(0.25, 0, 0.2) m", "5.0 cm"))
    assert failure.details["nearest_m"] == [0.25, 0.0, 0.2]
    assert failure.details["distance_m"] == 0.05


def test_orientation_out_of_reach_is_answered_with_its_error_in_degrees():
    failure = out_of_reach(POSE, (0.3, 0.0, 0.2), Deviation(0.001, math.radians(25.0)), [])
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert "25.0°" in failure.message
    assert failure.details["orientation_rad"] == pytest.approx(math.radians(25.0))


def test_constraints_out_of_reach_are_answered_with_what_does_not_hold():
    failure = out_of_reach(ConstraintGoal(Constraints()), (0.0, 0.0, 0.0), Deviation(), [VIOLATION])
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert VIOLATION.sentence in failure.message


def test_a_timeout_tells_how_near_the_search_came():
    late = PlanningFailure(MoveItErrorCode.TIMED_OUT, "too late", {"allowed_time_s": 0.01})
    failure = out_of_time(POINT, late, (0.25, 0.0, 0.2), Deviation(0.05))
    assert failure.code is MoveItErrorCode.TIMED_OUT
    assert "5.0 cm" in failure.message
    assert failure.details == {"allowed_time_s": 0.01, "nearest_m": [0.25, 0.0, 0.2], "distance_m": 0.05}
    assert out_of_time(ConstraintGoal(Constraints()), late, (0.0, 0.0, 0.0), Deviation()) is late
