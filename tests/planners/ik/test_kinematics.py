"""Inverse kinematics: constraints, the differential solver and exact solutions."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from planners.goals import OrientationConstraint as Orientation
from planners.goals import PositionConstraint as Region
from planners.ik import constraints
from planners.ik.constraints import AxisCondition, ConditionSet, TurnCondition, conditions, goal_conditions
from planners.ik.differential import Task, barrier, bounded_least_squares, free_directions, solve, velocity_limit
from planners.ik.kinematics import Descent, GoalConditions, Kinematics
from planners.scene import Pose
from robot.description import model
from tests.helpers import robots
from tests.helpers.resources import examples

TIP = "gripper_frame_link"
HOME = np.zeros(6)
UP = np.array([0.0, 0.0, 1.0])


def violated(condition, turn_rad=(0.0, 0.0, 0.0), position_m=(0.0, 0.0, 0.0)):
    placed = pin.SE3(pin.exp3(np.array(turn_rad)), np.array(position_m))
    return condition.violation(condition.error(placed)).any()


def test_box_region_lies_along_its_own_axes_and_an_axis_does_not_mind_turns_about_itself():
    quarter = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))
    region = constraints.PointCondition("tip", np.zeros(3), np.zeros(3), quarter, np.array([0.3, 0.1, 0.1]))
    assert not violated(region, position_m=(0.0, 0.25, 0.0))
    assert violated(region, position_m=(0.25, 0.0, 0.0))
    # One that is parallel or opposite has a finite way.
    for direction, angle in ((UP, 0.0), (-UP, np.pi)):
        error = AxisCondition("tip", UP, direction, 0.1).error(pin.SE3.Identity())
        assert np.linalg.norm(error) == pytest.approx(angle)
    condition = AxisCondition("tip", UP, UP, np.array([0.1, 0.1, np.pi]))
    assert not violated(condition, (0.0, 0.0, 3.0))
    assert violated(condition, (0.2, 0.0, 0.0))


@pytest.fixture
def forward(goal_states):
    return goal_states.forward


@pytest.fixture
def condition_set(forward, collision):
    return lambda **parts: ConditionSet(forward, conditions(Constraints(**parts), collision))


def pose_of(forward, q, link=TIP):
    forward.place(q)
    values = pin.SE3ToXYZQUAT(forward.placement(link)).tolist()
    return Pose(tuple(values[:3]), tuple(values[3:]))


def test_a_pose_of_a_configuration_holds_there_and_not_elsewhere(forward, collision):
    for q in np.random.default_rng(0).uniform(collision.lower_rad, collision.upper_rad, (5, 6)):
        goal = PoseGoal(TIP, pose_of(forward, q), 0.01, (0.05, 0.05, 0.05), strict=True)
        wanted = ConditionSet(forward, goal_conditions(goal, collision).required)
        assert wanted.holds(q)
        assert wanted.deviation(q).position_m == pytest.approx(0.0, abs=1e-9)
        turned = q + 0.1 * np.eye(6)[collision.joint_names.index("wrist_roll")]
        assert not wanted.holds(turned)
        assert wanted.deviation(turned).orientation_rad == pytest.approx(0.1, abs=1e-6)
    # Directions are taken as unit vectors.
    pose = pose_of(forward, HOME)
    axis = constraints.rotation(pose.orientation)[:, 2]
    goal = AxisGoal(TIP, pose.position_m, 0.001, (0.0, 0.0, 1.0005), tuple(0.9995 * axis), 0.01)
    assert ConditionSet(forward, goal_conditions(goal, collision).required).holds(HOME)


def test_free_axes_of_an_orientation_are_not_aimed_at_and_a_joint_range_ends_at_the_joints_limits(
    condition_set, collision
):
    for tolerance_rad, kinds in (
        ((0.1, 0.1, 0.1), [TurnCondition]),
        ((0.1, 0.1, 3.15), [AxisCondition]),
        ((0.1, 4.0, 4.0), [TurnCondition]),
        ((4.0, 4.0, 4.0), []),
    ):
        orientation = OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), tolerance_rad)
        found = conditions(Constraints(orientations=(orientation,)), collision)
        assert [type(condition) for condition in found] == kinds, tolerance_rad
    column = collision.joint_names.index("elbow_flex")
    upper = collision.upper_rad[column]
    wanted = condition_set(joints=(JointConstraint("elbow_flex", upper, 0.5, 0.1),))
    assert wanted.holds(upper * np.eye(6)[column])
    assert not wanted.holds((upper + 0.01) * np.eye(6)[column])
    # A weight that nobody set counts as one.
    constraint = JointConstraint("elbow_flex", 0.0, 0.1, 0.1, weight=0.0)
    assert conditions(Constraints(joints=(constraint,)), collision)[0].weight == 1.0


def test_violations_name_what_and_by_how_much(condition_set):
    wanted = condition_set(
        joints=(JointConstraint("elbow_flex", 0.5, 0.1, 0.1),),
        positions=(PositionConstraint(TIP, Pose((0.3913, 0.0, 0.2264 + 0.05)), radius_m=0.03),),
    )
    joint, position = wanted.violations(HOME)
    assert joint.sentence == "joint 'elbow_flex' is at 0 rad, outside 0.4 to 0.6 rad"
    assert joint.details["lower_rad"] == pytest.approx(0.4)
    assert "2.0 cm outside" in position.sentence
    assert position.details["beyond_m"] == pytest.approx(0.02, abs=1e-3)


DAMPING = 0.01


def problem(seed):
    """A problem of five unknowns, some of its inequalities at their bounds from the start."""
    chance = np.random.default_rng(seed)
    bounds = np.maximum(chance.normal(size=12), 0.0)
    return chance.normal(size=(3, 5)), chance.normal(size=3), DAMPING, chance.normal(size=(12, 5)), bounds


@examples(100)
@given(st.integers(0, 10**6))
def test_the_solution_keeps_every_inequality_and_is_optimal(seed):
    matrix, wanted, damping, rows, bounds = problem(seed)
    x, active = bounded_least_squares(matrix, wanted, damping, rows, bounds)
    assert (rows @ x <= bounds + 1e-7).all()
    # Karush, Kuhn and Tucker: what is left of the slope is held by the active inequalities, each pushing back.
    slope = matrix.T @ (wanted - matrix @ x) - damping**2 * x
    pushes = np.linalg.lstsq(rows[active].T, slope, rcond=None)[0]
    assert rows[active].T @ pushes == pytest.approx(slope, abs=1e-5)
    assert (pushes >= -1e-5).all()


def test_a_task_of_lower_priority_changes_nothing_about_the_first_and_of_two_alike_the_costlier_is_met_better():
    chance = np.random.default_rng(2)
    jacobian, angular = chance.normal(size=(2, 3, 6))
    wanted = Task(jacobian, np.array([0.1, 0.2, -0.1]))
    limit = velocity_limit(np.full(6, 0.3))
    first, _ = solve([wanted], 1e-6, limit)
    both, active = solve([Task(angular, np.ones(3))], 1e-3, limit, first, free_directions(jacobian, 1e-6))
    assert jacobian @ both == pytest.approx(wanted.velocity, abs=1e-6)
    assert np.linalg.norm(angular @ both - 1.0) < np.linalg.norm(angular @ first - 1.0)
    assert active.size
    assert np.abs(both).max() <= 0.3 + 1e-9
    tasks = [Task(np.eye(2), np.zeros(2)), Task(np.eye(2), np.ones(2), 3.0)]
    assert solve(tasks, 1e-6)[0] == pytest.approx([0.9, 0.9])


@pytest.mark.parametrize("distance", [0.0, 1e-4, 0.01, 0.3])
def test_behind_a_barrier_a_joint_comes_to_rest_in_time(distance):
    change, period = 0.02, 0.02
    limit = barrier(np.array([distance]), np.array([[-1.0]]), np.array([change]), period, gain=100.0)
    velocity = float(limit.bounds[0])
    way = 0.0
    while velocity > 0.0:
        way += velocity * period
        velocity -= change
    assert way <= distance + 1e-12
    assert limit.rows == pytest.approx(np.array([[1.0]]))


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


def test_tolerances_are_used_where_the_middle_cannot_be_had_and_weights_decide_what_cannot_both_hold(so101):
    # To the middle of the region the arm would have to turn the other way than its joint may.
    region = Region(TIP, Pose((0.3, -0.4, 0.2)), half_size_m=(0.5, 0.7, 0.5))
    joint = JointConstraint("shoulder_pan", -0.8, 0.3, 0.3)
    descent, holds = so101.descent(joints=(joint,), positions=(region,))
    assert holds(descent(HOME))

    def height_m(weight):
        high = Region(TIP, Pose((0.3, 0.0, 0.3)), radius_m=0.01, weight=weight)
        low = Region(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.01)
        descent, _ = so101.descent(positions=(high, low))
        return pose_of(so101.forward, descent(HOME)).position_m[2]

    assert height_m(0.2) < height_m(1.0) - 0.02 < height_m(5.0) - 0.04


def test_points_of_links_that_use_the_same_frame_are_told_apart_and_inside_is_near_if_it_is_anywhere(so101):
    goals = [PositionGoal(link, (0.2, 0.1, 0.15), 0.001, (0.01, 0.0, 0.02)) for link in (TIP, "wrist_link")]
    wanted = [goal_conditions(goal, so101.collision) for goal in goals]
    descents = [Descent(so101.kinematics, so101.arm, each) for each in wanted]
    for each, descent in zip(wanted, descents, strict=True):
        assert ConditionSet(so101.forward, each.required).holds(descent(HOME))
    near = np.array([0.0, -0.2, 0.3, 1.3, 0.2, 0.0])
    descent, holds = so101.descent(orientations=(Orientation(TIP, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 3.2)),))
    inside = descent.inside(near)
    assert holds(inside)
    assert np.max(np.abs(inside - near)) < 0.5
    impossible, _ = so101.descent(positions=(Region(TIP, Pose((2.0, 0.0, 0.0)), radius_m=0.1),))
    assert impossible.inside(near) is None
