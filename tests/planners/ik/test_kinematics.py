import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import (
    AxisGoal,
    Constraints,
    JointConstraint,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
from planners.ik.constraints import (
    ConditionSet,
    conditions,
    goal_conditions,
)
from planners.ik.kinematics import Descent, GoalConditions, Kinematics
from planners.scene import Pose
from robot.description import model
from tests.helpers import robots
from tests.planners.ik.test_constraints import pose_of

TIP = "gripper_frame_link"


def test_points_of_two_links_that_use_the_same_frame_are_told_apart(so101):
    goals = [PositionGoal(link, (0.2, 0.1, 0.15), 0.001, (0.01, 0.0, 0.02)) for link in (TIP, "wrist_link")]
    descents = [Descent(so101.kinematics, so101.arm, goal_conditions(goal, so101.collision)) for goal in goals]
    assert all(so101.holds(goal, descent(HOME)) for goal, descent in zip(goals, descents, strict=True))


HOME = np.zeros(6)


class Bench:
    """A robot whose descents are looked at."""

    def __init__(self, robot, tip):
        self.tip = tip
        self.arm = robot.groups["arm"]
        collision = CollisionModel(robot)
        self.collision = collision
        self.forward = ForwardKinematics(robot, collision.joint_names)
        self.kinematics = Kinematics(robot, self.forward, collision.joint_names)

    def states(self, count, seed=1):
        return np.random.default_rng(seed).uniform(
            self.collision.lower_rad, self.collision.upper_rad, (count, len(self.collision.joint_names))
        )

    def descend(self, goal, q):
        return Descent(self.kinematics, self.arm, goal_conditions(goal, self.collision))(q)

    def holds(self, goal, q):
        return ConditionSet(self.forward, goal_conditions(goal, self.collision).required).holds(q)


@pytest.fixture(scope="module")
def so101(robot):
    return Bench(robot, TIP)


@pytest.fixture(scope="module")
def seven():
    return Bench(model.parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF), "tool")


def goals_at(bench, q):
    pose = pose_of(bench.forward, q, bench.tip)
    bench.forward.place(q)
    placement = bench.forward.placement(bench.tip)
    offset_m = np.array([0.02, -0.01, 0.03])
    direction = placement.rotation[:, 0]
    return {
        "point": PositionGoal(bench.tip, pose.position_m, 0.001),
        "offset": PositionGoal(
            bench.tip, tuple(placement.translation + placement.rotation @ offset_m), 0.001, tuple(offset_m)
        ),
        "axis": AxisGoal(bench.tip, pose.position_m, 0.001, (1.0, 0.0, 0.0), tuple(direction), 0.02),
        "pose": PoseGoal(bench.tip, pose, 0.001, (0.02, 0.02, 0.02), strict=True),
    }


@pytest.mark.parametrize("kind", ["point", "offset", "axis", "pose"])
@pytest.mark.parametrize("arm_name", ["so101", "seven"])
def test_the_goal_of_a_nearby_configuration_is_reached(arm_name, kind, request):
    bench = request.getfixturevalue(arm_name)
    inner = 0.8 * bench.states(25)
    reached = 0
    for q in inner:
        goal = goals_at(bench, q)[kind]
        end = bench.descend(goal, q + np.random.default_rng(3).uniform(-0.2, 0.2, len(q)))
        reached += bench.holds(goal, end)
        assert np.all((end >= bench.collision.lower_rad) & (end <= bench.collision.upper_rad))
    assert reached >= 23


def test_tolerances_are_used_where_the_middle_cannot_be_had(so101):
    # To the middle of the region the arm would have to turn the other way than its joint may.
    region = PositionConstraint(TIP, Pose((0.3, -0.4, 0.2)), half_size_m=(0.5, 0.7, 0.5))
    joint = JointConstraint("shoulder_pan", -0.8, 0.3, 0.3)
    wanted = GoalConditions(conditions(Constraints(joints=(joint,), positions=(region,)), so101.collision))
    end = Descent(so101.kinematics, so101.arm, wanted)(HOME)
    assert ConditionSet(so101.forward, wanted.required).holds(end)


def test_weights_decide_between_what_cannot_both_hold(so101):
    def heights(weight):
        high = PositionConstraint(TIP, Pose((0.3, 0.0, 0.3)), radius_m=0.01, weight=weight)
        low = PositionConstraint(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.01)
        wanted = GoalConditions(conditions(Constraints(positions=(high, low)), so101.collision))
        so101.forward.place(Descent(so101.kinematics, so101.arm, wanted)(HOME))
        return so101.forward.placement(TIP).translation[2]

    assert heights(0.2) < heights(1.0) - 0.02 < heights(5.0) - 0.04


def test_inside_is_near_and_none_where_there_is_none(so101):
    down = OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2))
    wanted = GoalConditions(conditions(Constraints(orientations=(down,)), so101.collision))
    descent = Descent(so101.kinematics, so101.arm, wanted)
    near = np.array([0.0, -0.2, 0.3, 1.3, 0.2, 0.0])
    inside = descent.inside(near)
    assert ConditionSet(so101.forward, wanted.required).holds(inside)
    assert np.max(np.abs(inside - near)) < 0.5
    far = PositionConstraint(TIP, Pose((2.0, 0.0, 0.0)), radius_m=0.1)
    impossible = GoalConditions(conditions(Constraints(positions=(far,)), so101.collision))
    assert Descent(so101.kinematics, so101.arm, impossible).inside(near) is None
