"""Motions of one of two arms while the other one sags onto itself."""

import functools
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
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    RecheckQuestion,
    Request,
    StateAnswer,
    StateQuestion,
)
from planners.scene import Pose
from planners.servo.question import JointVelocities, ServoAnswer, ServoLimits, ServoQuestion
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.joined import PlacedArm, joined, prefixed
from tests.helpers.robots import so101

ONE = so101()
PAIR = joined(
    "pair",
    {
        side: PlacedArm(prefixed(ONE, side), base_xyz_m=(0.0, y_m, 0.0))
        for side, y_m in (("left", 0.4), ("right", -0.4))
    },
)
LEFT = tuple(f"left_{name}" for name in ONE.groups["arm"].joints)

# The forearm is 50 mm deep in the base.
SAGGING = {"shoulder_lift": 1.36, "elbow_flex": 1.47, "wrist_flex": -0.47}
START_RAD = dict.fromkeys((joint.name for joint in PAIR.movable_joints), 0.0) | {
    f"right_{name}": value for name, value in SAGGING.items()
}
GOAL_RAD = dict(zip(LEFT, (0.6, -0.4, 0.3, 0.2, 0.5), strict=True))


@functools.cache
def planner() -> Planner:
    return Planner(PAIR, time.process_time)


def motion() -> Plan:
    plan = planner().answer(PlanningProblem("left_arm", START_RAD, JointGoal(GOAL_RAD)))
    assert isinstance(plan, Plan), plan
    return plan


def test_the_other_arm_moves() -> None:
    assert np.allclose(motion().trajectory.positions_rad[-1], list(GOAL_RAD.values()))


def test_its_motion_is_free_on_the_way() -> None:
    trajectory = motion().trajectory
    others = {name: value for name, value in START_RAD.items() if name not in LEFT}
    assert planner().answer(RecheckQuestion("left_arm", trajectory, others, 0.1)) == RecheckAnswer(None)


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        (IkQuestion("left_arm", START_RAD, JointGoal(GOAL_RAD)), IkAnswer),
        (JointPathProblem(START_RAD, LEFT, np.array([0.0, 2.0]), np.array([[0.0] * 5, [0.2] * 5])), Plan),
        (
            ServoQuestion(
                "left_arm",
                "left_gripper_frame_link",
                START_RAD,
                {},
                0.02,
                JointVelocities({"left_shoulder_pan": 0.3}),
                None,
                ServoLimits(),
            ),
            ServoAnswer,
        ),
    ],
)
def test_questions_about_the_other_arm_are_answered(request_: Request, answer: type) -> None:
    found = planner().answer(request_)
    assert isinstance(found, answer), found
    if isinstance(found, ServoAnswer):
        assert found.velocity_rad_s["left_shoulder_pan"] > 0.0


def test_the_tip_of_the_other_arm_follows_a_path() -> None:
    x, y, z = ForwardPlacements(PAIR).transforms(START_RAD)["left_gripper_frame_link"][:3, 3].tolist()
    line = Line(Pose((x - 0.05, y, z), (0.0, 0.0, 0.0, 1.0)))
    found = planner().answer(CartesianProblem("left_arm", START_RAD, "left_gripper_frame_link", (line,)))
    assert isinstance(found, CartesianPlan), found
    assert found.fraction > 0.9


@pytest.mark.parametrize("group", ["right_arm", "both_arms"])
def test_the_arm_that_sags_does_not_move_out_of_a_deep_contact(group: str) -> None:
    motion()
    goal_rad = dict.fromkeys(PAIR.groups[group].joints, 0.1)
    found = planner().answer(PlanningProblem(group, START_RAD, JointGoal(goal_rad)))
    assert isinstance(found, PlanningFailure)
    assert found.code is MoveItErrorCode.START_STATE_IN_COLLISION


def test_a_question_about_the_state_names_the_contact() -> None:
    motion()
    found = planner().answer(StateQuestion("left_arm", START_RAD))
    assert isinstance(found, StateAnswer)
    assert not found.valid


def test_an_obstacle_of_the_other_arm_is_kept_clear_of() -> None:
    goal_rad = GOAL_RAD | {"left_shoulder_lift": 1.36, "left_elbow_flex": 1.47, "left_wrist_flex": -0.47}
    found = planner().answer(PlanningProblem("left_arm", START_RAD, JointGoal(goal_rad)))
    assert isinstance(found, PlanningFailure)
    assert found.code is MoveItErrorCode.GOAL_IN_COLLISION
