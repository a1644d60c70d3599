"""Motions of one of two arms while the other one sags onto itself."""

import time

import numpy as np
import pytest

from planners.goals import JointGoal
from planners.pipeline import Planner
from planners.problem import (
    CartesianPlan,
    CartesianProblem,
    IkAnswer,
    IkQuestion,
    JointPathProblem,
    Line,
    Plan,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
    StateQuestion,
)
from planners.problem import MoveItErrorCode as Code
from planners.scene import Pose
from planners.servo.question import JointVelocities, ServoLimits, ServoQuestion
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.joined import PlacedArm, joined, prefixed
from tests.helpers.robots import so101

ONE = so101()
SIDES = {"left": 0.4, "right": -0.4}
PLACED = {side: PlacedArm(prefixed(ONE, side), base_xyz_m=(0.0, y_m, 0.0)) for side, y_m in SIDES.items()}
PAIR = joined("pair", PLACED)
LEFT = tuple(f"left_{name}" for name in ONE.groups["arm"].joints)
TIP = "left_gripper_frame_link"

# The forearm is 50 mm deep in the base.
SAGGING = {"shoulder_lift": 1.36, "elbow_flex": 1.47, "wrist_flex": -0.47}
START_RAD = dict.fromkeys((joint.name for joint in PAIR.movable_joints), 0.0) | {
    f"right_{name}": value for name, value in SAGGING.items()
}
GOAL_RAD = dict(zip(LEFT, (0.6, -0.4, 0.3, 0.2, 0.5), strict=True))


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(PAIR, time.process_time)


def test_the_other_arm_moves_and_its_motion_is_free_on_the_way(planner: Planner) -> None:
    plan = planner.answer(PlanningProblem("left_arm", START_RAD, JointGoal(GOAL_RAD)))
    assert isinstance(plan, Plan), plan
    assert np.allclose(plan.trajectory.positions_rad[-1], list(GOAL_RAD.values()))
    others = {name: value for name, value in START_RAD.items() if name not in LEFT}
    assert planner.answer(RecheckQuestion("left_arm", plan.trajectory, others, 0.1)) == RecheckAnswer(None)


def test_questions_about_the_other_arm_are_answered(planner: Planner) -> None:
    assert isinstance(planner.answer(IkQuestion("left_arm", START_RAD, JointGoal(GOAL_RAD))), IkAnswer)
    points = np.array([[0.0] * 5, [0.2] * 5])
    assert isinstance(planner.answer(JointPathProblem(START_RAD, LEFT, np.array([0.0, 2.0]), points)), Plan)
    command = JointVelocities({"left_shoulder_pan": 0.3})
    steered = planner.answer(ServoQuestion("left_arm", TIP, START_RAD, {}, 0.02, command, None, ServoLimits()))
    assert steered.velocity_rad_s["left_shoulder_pan"] > 0.0
    x, y, z = ForwardPlacements(PAIR).transforms(START_RAD)[TIP][:3, 3].tolist()
    line = Line(Pose((x - 0.05, y, z), (0.0, 0.0, 0.0, 1.0)))
    followed = planner.answer(CartesianProblem("left_arm", START_RAD, TIP, (line,)))
    assert isinstance(followed, CartesianPlan), followed
    assert followed.fraction > 0.9


def test_the_arm_that_sags_does_not_move_out_of_a_deep_contact_which_a_question_about_its_state_names(planner) -> None:
    for group in ("right_arm", "both_arms"):
        goal_rad = dict.fromkeys(PAIR.groups[group].joints, 0.1)
        found = planner.answer(PlanningProblem(group, START_RAD, JointGoal(goal_rad)))
        assert found.code is Code.START_STATE_IN_COLLISION
    state = planner.answer(StateQuestion("left_arm", START_RAD))
    assert not state.valid
    assert "right_base_link and right_wrist_link by 51" in state.problems[0].message


def test_a_goal_in_which_the_other_arm_would_touch_itself_is_refused(planner: Planner) -> None:
    goal_rad = GOAL_RAD | {f"left_{name}": value for name, value in SAGGING.items()}
    found = planner.answer(PlanningProblem("left_arm", START_RAD, JointGoal(goal_rad)))
    assert found.code is Code.GOAL_IN_COLLISION
