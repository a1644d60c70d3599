"""Another shape of arm, which reaches full poses."""

import time

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode
from planners.scene import Pose
from robot.description import model
from tests.helpers import robots
from tests.helpers.resources import in_proportion
from tests.planners.setting import Setting, end_of


@pytest.fixture(scope="module")
def seven():
    return model.parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)


@pytest.fixture(scope="module")
def seven_setting(seven):
    return Setting(Planner(seven, time.process_time), seven, CollisionModel(seven), "tool")


@pytest.fixture
def bent(seven):
    return dict(seven.named_states["arm"]["bent"])


@pytest.mark.parametrize("seed", range(in_proportion(8)))
def test_joint_position_and_pose_goals_are_reached(seven_setting, bent, seed):
    witness = seven_setting.random_state(np.random.default_rng(seed))
    pose = seven_setting.tip_pose(witness)
    joint_goal = JointGoal({name: witness[name] for name in seven_setting.joints})
    assert end_of(seven_setting.solve(seven_setting.problem(joint_goal, bent))) == joint_goal.positions_rad
    for goal in (
        PositionGoal("tool", pose.position_m, 0.002),
        PoseGoal("tool", pose, 0.002, (0.02, 0.02, 0.02), strict=True),
    ):
        plan = seven_setting.solve(seven_setting.problem(goal, bent))
        reached = seven_setting.tip_pose(bent | end_of(plan))
        assert np.linalg.norm(np.subtract(reached.position_m, pose.position_m)) <= 0.002
        assert plan.deviation.orientation_rad <= 0.035


def test_pose_out_of_reach_is_refused_with_the_distance(seven_setting, bent):
    goal = PoseGoal("tool", Pose((0.0, 0.0, 2.0)), 0.002, (0.02, 0.02, 0.02), strict=True)
    failure = seven_setting.planner.plan(seven_setting.problem(goal, bent))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert failure.details["distance_m"] == pytest.approx(2.0 - 0.75, abs=0.01)
