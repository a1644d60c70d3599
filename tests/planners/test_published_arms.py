"""Goals of published arms, with joints that mimic, arms on a torso, and meshes in three formats."""

from __future__ import annotations

import time
from importlib import metadata

import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import JointGoal, PoseGoal
from planners.pipeline import Planner
from planners.problem import CartesianPlan, CartesianProblem, Line, Plan, PlanningProblem
from planners.scene import Pose
from robot.description import model
from robot.description.example_robots import PACKAGE, find_example
from tests.helpers.resources import in_proportion
from tests.planners.ik.test_constraints import pose_of
from tests.planners.invariants import assert_touches_nothing

# Group and tip; UR5's own SRDF has no group.
ARMS = {
    "panda": ("arm", "panda_hand_tcp"),
    "ur5": ("manipulator", "tool0"),
    "xarm7": ("xarm7", "link_eef"),
    "kinova": ("end_effector", "j2s6s200_end_effector"),
    "pr2": ("right_arm_and_torso", "r_wrist_roll_link"),
}
UR5_GROUP = '<group name="manipulator"><chain base_link="world" tip_link="tool0"/></group></robot>'


def installed():
    try:
        return metadata.distribution(PACKAGE) is not None
    except metadata.PackageNotFoundError:
        return False


pytestmark = pytest.mark.skipif(not installed(), reason=f"{PACKAGE} is not installed (pip install {PACKAGE})")


class Arm:
    """A published arm with its planner."""

    def __init__(self, name):
        self.group, self.tip = ARMS[name]
        example = find_example(name)
        srdf = example.srdf.read_text()
        self.robot = model.parse(
            example.urdf.read_text(),
            srdf.replace("</robot>", UR5_GROUP) if name == "ur5" else srdf,
            mesh_directory=example.urdf.parent,
            package_directories=example.packages,
        )
        self.planner = Planner(self.robot, time.process_time)
        self.collision = CollisionModel(self.robot)
        self.forward = ForwardKinematics(self.robot, self.collision.joint_names)
        self.joints = self.robot.groups[self.group].joints
        self.names = self.collision.joint_names

    def state(self, rng):
        """Return a free state, the joints outside the group where they are least turned."""
        lower, upper = self.collision.lower_rad, self.collision.upper_rad
        columns = [self.names.index(name) for name in self.joints]
        while True:
            q = np.clip(np.zeros(len(lower)), lower, upper)
            q[columns] = rng.uniform(lower, upper)[columns]
            if not self.collision.in_collision(q):
                return q

    def named(self, q):
        return dict(zip(self.names, q.tolist(), strict=True))

    def plan(self, start_q, goal):
        plan = self.planner.plan(PlanningProblem(self.group, self.named(start_q), goal))
        assert isinstance(plan, Plan), plan
        assert_touches_nothing(plan.trajectory, self.collision, self.named(start_q))
        ends = zip(plan.trajectory.joint_names, plan.trajectory.positions_rad[-1].tolist(), strict=True)
        reached = self.named(start_q) | dict(ends)
        return np.array([reached[name] for name in self.names])


@pytest.fixture(scope="module", params=ARMS)
def arm(request):
    return Arm(request.param)


@pytest.mark.parametrize("seed", range(in_proportion(4)))
def test_joint_goals_are_reached(arm, seed):
    rng = np.random.default_rng(seed)
    start_q, goal_q = arm.state(rng), arm.state(rng)
    goal = JointGoal({name: arm.named(goal_q)[name] for name in arm.joints})
    np.testing.assert_allclose(arm.plan(start_q, goal), goal_q, atol=1e-6)


@pytest.mark.parametrize("seed", range(in_proportion(4)))
def test_full_poses_are_reached(arm, seed):
    rng = np.random.default_rng(seed)
    start_q, pose = arm.state(rng), pose_of(arm.forward, arm.state(rng), arm.tip)
    goal = PoseGoal(arm.tip, pose, 0.001, (0.01, 0.01, 0.01), strict=True)
    reached = pose_of(arm.forward, arm.plan(start_q, goal), arm.tip)
    assert np.linalg.norm(np.subtract(reached.position_m, pose.position_m)) <= 0.001
    assert 2.0 * np.arccos(min(1.0, abs(np.dot(reached.orientation, pose.orientation)))) <= 0.01 * 3.0**0.5


def test_the_tip_follows_a_line_of_eight_centimetres(arm):
    rng = np.random.default_rng(0)
    for _ in range(20):
        start_q = arm.state(rng)
        at = pose_of(arm.forward, start_q, arm.tip)
        x, y, z = at.position_m
        line = Line(Pose((x, y, z + 0.08), at.orientation))
        answer = arm.planner.answer(
            CartesianProblem(arm.group, arm.named(start_q), arm.tip, (line,), keep_orientation=True)
        )
        if isinstance(answer, CartesianPlan) and answer.fraction == 1.0:
            return
    raise AssertionError("no line of twenty could be followed")
