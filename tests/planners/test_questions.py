import numpy as np
import pytest

from planners.goals import Constraints, JointConstraint, JointGoal, PositionGoal
from planners.problem import IkAnswer, IkQuestion, MoveItErrorCode, StateQuestion

TIP = "gripper_frame_link"
FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.69, "wrist_flex": 1.2}


def tip_m(collision, positions_rad):
    return collision.tip_positions([np.array([positions_rad[name] for name in collision.joint_names])], TIP)[0]


def test_configuration_for_a_point_is_one_by_name_for_every_joint(planner, collision, at_home):
    answer = planner.answer(IkQuestion("arm", at_home | {"gripper": 0.3}, PositionGoal(TIP, (0.25, 0.1, 0.2), 0.001)))
    assert isinstance(answer, IkAnswer)
    (positions_rad,) = answer.positions_rad
    assert set(positions_rad) == set(at_home)
    assert positions_rad["gripper"] == 0.3
    assert np.linalg.norm(tip_m(collision, positions_rad) - (0.25, 0.1, 0.2)) <= 0.001
    assert answer.deviations[0].position_m <= 0.001


def test_configuration_in_contact_is_an_answer_only_if_contacts_do_not_matter(planner, at_home):
    question = IkQuestion("arm", at_home, JointGoal(FOLDED))
    assert planner.answer(question).code is MoveItErrorCode.GOAL_IN_COLLISION
    free = planner.answer(IkQuestion("arm", at_home, JointGoal(FOLDED), avoid_collisions=False))
    assert free.positions_rad[0]["elbow_flex"] == 1.69


def test_constraints_hold_in_the_answer(planner, at_home):
    roll = Constraints(joints=(JointConstraint("wrist_roll", 1.0, 0.1, 0.1),))
    goal = PositionGoal(TIP, (0.25, 0.1, 0.2), 0.001)
    answer = planner.answer(IkQuestion("arm", at_home, goal, constraints=roll))
    assert answer.positions_rad[0]["wrist_roll"] == pytest.approx(1.0, abs=0.101)


def test_bad_questions_are_refused(planner, at_home):
    goal = PositionGoal(TIP, (0.25, 0.1, 0.2), 0.001)
    assert planner.answer(IkQuestion("leg", at_home, goal)).code is MoveItErrorCode.INVALID_GROUP_NAME
    assert planner.answer(IkQuestion("arm", {}, goal)).code is MoveItErrorCode.START_STATE_INVALID
    assert planner.answer(StateQuestion("arm", {})).code is MoveItErrorCode.START_STATE_INVALID


def test_all_that_is_wrong_with_a_state_is_told(planner, at_home):
    assert planner.answer(StateQuestion("arm", at_home)).problems == ()
    wrong = at_home | FOLDED | {"wrist_roll": 3.0}
    roll = Constraints(joints=(JointConstraint("wrist_roll", 1.0, 0.1, 0.1),))
    answer = planner.answer(StateQuestion("arm", wrong, roll))
    assert not answer.valid
    assert [problem.code for problem in answer.problems] == [
        MoveItErrorCode.INVALID_ROBOT_STATE,
        MoveItErrorCode.START_STATE_IN_COLLISION,
        MoveItErrorCode.GOAL_CONSTRAINTS_VIOLATED,
    ]
    assert answer.problems[0].details["joint"] == "wrist_roll"
    assert answer.problems[1].details["pairs"]
