import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import AxisGoal, Constraints, JointConstraint, PoseGoal, PositionGoal
from planners.goals import OrientationConstraint as Orientation
from planners.goals import PositionConstraint as Region
from planners.ik.constraints import ConditionSet, conditions, goal_conditions
from planners.ik.kinematics import Descent, GoalConditions, Kinematics
from planners.scene import Pose
from robot.description import model
from tests.helpers import robots
from tests.planners.ik.test_constraints import pose_of

TIP = "gripper_frame_link"
HOME = np.zeros(6)


class Bench:
    """A robot whose descents are looked at."""

    def __init__(self, robot, tip):
        self.tip = tip
        self.arm = robot.groups["arm"]
        self.collision = CollisionModel(robot)
        self.forward = ForwardKinematics(robot, self.collision.joint_names)
        self.kinematics = Kinematics(robot, self.forward, self.collision.joint_names)

    def descent(self, **constraints):
        """Return a descent to constraints, and the test whether they hold."""
        wanted = GoalConditions(conditions(Constraints(**constraints), self.collision))
        return Descent(self.kinematics, self.arm, wanted), ConditionSet(self.forward, wanted.required).holds

    def goals_at(self, q):
        pose = pose_of(self.forward, q, self.tip)
        rotation, offset_m = self.forward.placement(self.tip).rotation, np.array([0.02, -0.01, 0.03])
        place_m = tuple(pose.position_m + rotation @ offset_m)
        return {
            "point": PositionGoal(self.tip, pose.position_m, 0.001),
            "offset": PositionGoal(self.tip, place_m, 0.001, tuple(offset_m)),
            "axis": AxisGoal(self.tip, pose.position_m, 0.001, (1.0, 0.0, 0.0), tuple(rotation[:, 0]), 0.02),
            "pose": PoseGoal(self.tip, pose, 0.001, (0.02, 0.02, 0.02), strict=True),
        }


@pytest.fixture(scope="module")
def so101(robot):
    return Bench(robot, TIP)


@pytest.fixture(scope="module")
def seven():
    return Bench(model.parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF), "tool")


def test_points_of_two_links_that_use_the_same_frame_are_told_apart(so101):
    goals = [PositionGoal(link, (0.2, 0.1, 0.15), 0.001, (0.01, 0.0, 0.02)) for link in (TIP, "wrist_link")]
    wanted = [goal_conditions(goal, so101.collision) for goal in goals]
    descents = [Descent(so101.kinematics, so101.arm, each) for each in wanted]
    for each, descent in zip(wanted, descents, strict=True):
        assert ConditionSet(so101.forward, each.required).holds(descent(HOME))


@pytest.mark.parametrize("kind", ["point", "offset", "axis", "pose"])
@pytest.mark.parametrize("arm_name", ["so101", "seven"])
def test_the_goal_of_a_nearby_configuration_is_reached(arm_name, kind, request):
    bench, reached = request.getfixturevalue(arm_name), 0
    lower_rad, upper_rad = bench.collision.lower_rad, bench.collision.upper_rad
    for q in 0.8 * np.random.default_rng(1).uniform(lower_rad, upper_rad, (25, len(lower_rad))):
        wanted = goal_conditions(bench.goals_at(q)[kind], bench.collision)
        near = q + np.random.default_rng(3).uniform(-0.2, 0.2, len(q))
        end = Descent(bench.kinematics, bench.arm, wanted)(near)
        reached += ConditionSet(bench.forward, wanted.required).holds(end)
        assert np.all((end >= lower_rad) & (end <= upper_rad))
    assert reached >= 23


def test_tolerances_are_used_where_the_middle_cannot_be_had(so101):
    # To the middle of the region the arm would have to turn the other way than its joint may.
    region = Region(TIP, Pose((0.3, -0.4, 0.2)), half_size_m=(0.5, 0.7, 0.5))
    joint = JointConstraint("shoulder_pan", -0.8, 0.3, 0.3)
    descent, holds = so101.descent(joints=(joint,), positions=(region,))
    assert holds(descent(HOME))


def test_weights_decide_between_what_cannot_both_hold(so101):
    def height_m(weight):
        high = Region(TIP, Pose((0.3, 0.0, 0.3)), radius_m=0.01, weight=weight)
        low = Region(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.01)
        descent, _ = so101.descent(positions=(high, low))
        return pose_of(so101.forward, descent(HOME)).position_m[2]

    assert height_m(0.2) < height_m(1.0) - 0.02 < height_m(5.0) - 0.04


def test_inside_is_near_and_none_where_there_is_none(so101):
    near = np.array([0.0, -0.2, 0.3, 1.3, 0.2, 0.0])
    descent, holds = so101.descent(orientations=(Orientation(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
    inside = descent.inside(near)
    assert holds(inside)
    assert np.max(np.abs(inside - near)) < 0.5
    impossible, _ = so101.descent(positions=(Region(TIP, Pose((2.0, 0.0, 0.0)), radius_m=0.1),))
    assert impossible.inside(near) is None
