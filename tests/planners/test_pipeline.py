"""Planning from a problem to a trajectory, within its budget."""

import itertools
import shutil
import time

import numpy as np
import pytest

from planners.budget import Budget
from planners.checks import START_CONTACT_DEPTH_M
from planners.geometry.collision import CollisionModel
from planners.goals import AxisGoal, Constraints, JointConstraint, JointGoal, OrientationConstraint, PoseGoal
from planners.goals import PositionGoal as Point
from planners.ik.goal_states import GoalStates
from planners.motions.path import PROJECTED_SEARCH
from planners.motions.path_timing import time_along
from planners.motions.spline import NaturalSpline
from planners.pipeline import Planner, recheck
from planners.problem import (
    IkQuestion,
    JointPathProblem,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RateLimits,
    RecheckQuestion,
    StateQuestion,
)
from planners.problem import MoveItErrorCode as Code
from planners.scene import Box, Pose, Scene
from robot.description import model
from robot.description.robot_file import FILE_NAME
from robot.description.robot_folder import BUILT_IN, load
from tests.helpers.clock import FakeClock
from tests.planners.invariants import BLOCKED_LINES, assert_keeps_rates, assert_touches_nothing, configurations, refusal
from tests.planners.scenes import thing
from tests.planners.setting import TIP, end_of
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

# Folded a little too far: the hulls of lower arm and shoulder overlap by some 7 mm, the links themselves do not.
FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.65, "wrist_flex": 1.0}
ROLLED = Constraints(joints=(JointConstraint("wrist_roll", 1.0, 0.1, 0.1),))


@pytest.fixture
def blocked(setting):
    """A problem whose line is blocked by the arm itself."""
    start, goal = BLOCKED_LINES[0]
    goal = JointGoal(dict(zip(setting.joints, goal, strict=True)))
    return setting.problem(goal, setting.start(start, 0.0), attempts=2, seed=9)


@pytest.mark.parametrize("seed", range(6))
def test_random_joint_goals_are_reached_exactly_and_reachable_points_within_tolerance(setting, seed):
    rng = np.random.default_rng(seed)
    start, goal = setting.random_state(rng), setting.random_state(rng)
    point = Point(TIP, setting.tip_m(goal), 0.005)
    plan = setting.solve(setting.problem(point, start))
    assert np.linalg.norm(np.subtract(setting.tip_m(start | end_of(plan)), point.position_m)) <= point.tolerance_m
    goal_rad = {name: goal[name] for name in setting.joints}
    # With the jaw as the start has it.
    free_q = np.array([{**goal, "gripper": start["gripper"]}[name] for name in setting.collision.joint_names])
    if not setting.collision.in_collision(free_q):
        velocity_scaling, acceleration_scaling = rng.uniform(0.05, 1.0, 2).tolist()
        scaled = {"velocity_scaling": velocity_scaling, "acceleration_scaling": acceleration_scaling}
        assert end_of(setting.solve(setting.problem(JointGoal(goal_rad), start, **scaled))) == goal_rad


def test_motions_keep_the_jerk_limits_of_a_robot_file(setting, blocked, tmp_path):
    """The jerk is the difference quotient of the sampled acceleration."""
    jerk_rad_s3 = dict(zip(setting.joints, (40.0, 30.0, 50.0, 60.0, 70.0), strict=True))
    shutil.copytree(BUILT_IN / "so101", tmp_path / "so101")
    file = tmp_path / "so101" / FILE_NAME
    text = file.read_text()
    for name, limit in jerk_rad_s3.items():
        text = text.replace(f"[joints.{name}]\n", f"[joints.{name}]\nmax_jerk = {limit}\n")
    file.write_text(text)
    trajectory = Planner(load(file.parent).model, time.process_time).plan(blocked).trajectory
    step_s = 0.001
    accelerations = [trajectory.sample(time_s)[2] for time_s in np.arange(0.0, trajectory.duration_s, step_s)]
    jerks = np.abs(np.diff(accelerations, axis=0)).max(axis=0) / step_s
    limits = np.array([jerk_rad_s3[name] for name in trajectory.joint_names])
    assert (jerks <= 1.001 * limits).all()
    assert (jerks >= 0.4 * limits).any()
    assert trajectory.duration_s > setting.planner.plan(blocked).trajectory.duration_s


def test_same_problem_and_seed_have_the_same_plan_with_the_deviation_of_its_end(setting, blocked, robot):
    planners = setting.planner, Planner(robot, time.process_time), setting.planner
    first, *others = (planner.plan(blocked).trajectory for planner in planners)
    for trajectory in others:
        np.testing.assert_array_equal(trajectory.time_s, first.time_s)
        np.testing.assert_array_equal(trajectory.positions_rad, first.positions_rad)
    # A pose on five joints.
    pose = Pose((0.25, 0.1, 0.2))
    plan = setting.solve(setting.problem(PoseGoal(TIP, pose, 0.005, (0.01, 0.01, 0.01))))
    assert np.linalg.norm(np.subtract(setting.tip_m(setting.home() | end_of(plan)), pose.position_m)) <= 0.005
    assert plan.deviation.position_m <= 0.005
    assert plan.deviation.orientation_rad > 0.1


def test_goal_that_already_holds_needs_no_motion_and_a_start_slightly_beyond_a_limit_moves_from_the_limit(setting):
    for goal in (JointGoal({}), JointGoal({"wrist_roll": 0.0}), Point(TIP, (0.39, 0.0, 0.226), 0.01)):
        plan = setting.solve(setting.problem(goal))
        assert (plan.method, plan.trajectory.duration_s) == ("nothing to do", 0.0), goal
    upper = setting.robot.joints["wrist_roll"].upper
    plan = setting.planner.plan(setting.problem(JointGoal({"elbow_flex": 0.5}), setting.home(wrist_roll=upper + 0.02)))
    assert plan.trajectory.positions_rad[0, setting.joints.index("wrist_roll")] == upper


def test_a_goal_out_of_reach_or_a_start_outside_the_path_constraints_is_refused_with_what_is_wrong(setting):
    failure = setting.planner.plan(setting.problem(Point(TIP, (0.1, 0.0, 0.15), 0.01)))
    assert failure.code is Code.NO_IK_SOLUTION
    assert "4.1 cm" in failure.message
    assert failure.details["distance_m"] == pytest.approx(0.041, abs=0.001)
    assert "metres" not in failure.message
    setting.solve(setting.problem(Point(TIP, tuple(failure.details["nearest_m"]), 0.001)))
    in_millimetres = setting.planner.plan(setting.problem(Point(TIP, (250.0, 0.0, 150.0), 0.01)))
    assert in_millimetres.message.endswith(" cm away; positions are in metres")
    failure = setting.planner.plan(setting.problem(JointGoal({"wrist_roll": 1.0}), path_constraints=ROLLED))
    assert failure.code is Code.START_STATE_VIOLATES_PATH_CONSTRAINTS
    assert failure.details["violations"][0]["joint"] == "wrist_roll"


def test_arm_that_touches_itself_in_the_hulls_only_may_leave_or_stay_but_not_go_deeper(setting):
    start = setting.home(**FOLDED)
    plan = setting.planner.plan(setting.problem(JointGoal({"shoulder_lift": -0.5, "elbow_flex": 0.5}), start))
    assert isinstance(plan, Plan), plan
    states = list(configurations(plan.trajectory, setting.collision, start))
    depths_m = [max((pair.depth_m for pair in setting.collision.colliding_pairs(q)), default=0.0) for q in states[::5]]
    assert 0.0 < depths_m[0] <= START_CONTACT_DEPTH_M
    assert max(depths_m) <= depths_m[0] + 0.0005
    assert depths_m[-1] == 0.0
    assert setting.planner.plan(setting.problem(JointGoal({}), start)).method == "nothing to do"
    deeper = JointGoal({"shoulder_lift": -1.74, "elbow_flex": 1.69})
    assert setting.planner.plan(setting.problem(deeper, start)).code is Code.GOAL_IN_COLLISION


@pytest.mark.parametrize("kind", ["plan", "recheck", "joint path"])
def test_work_that_is_cancelled_stops_at_once_whenever_that_is(setting, kind):
    # With links that touch in their hulls each check takes long.
    start = setting.home(**FOLDED)
    problem = setting.problem(JointGoal({"elbow_flex": 0.5}), start)
    motion = setting.planner.plan(problem).trajectory
    requests = {
        "plan": problem,
        "recheck": RecheckQuestion("arm", motion, start, 0.0),
        "joint path": JointPathProblem(start, motion.joint_names, motion.time_s, motion.positions_rad),
    }
    asked = itertools.count()
    assert not isinstance(setting.planner.answer(requests[kind], lambda: bool(next(asked) < 0)), PlanningFailure)
    total = next(asked)
    assert total > 10
    for last in range(0, total, 1 + total // 8):
        asked = itertools.count()
        answer = setting.planner.answer(requests[kind], lambda: next(asked) >= last)  # noqa: B023
        assert answer.code is Code.PREEMPTED
        assert next(asked) <= last + 4


def test_an_arm_of_another_kind_is_planned_for_until_the_time_is_over():
    crane, ticks = model.parse(CRANE_URDF, CRANE_SRDF), iter(range(1000))
    planner, collision = Planner(crane, time.process_time), CollisionModel(crane)
    start = {"turn": 0.0, "lift": 0.0, "slide": 0.0}
    problem = PlanningProblem("arm", start, Point("rod", (0.1, 0.3, 0.3), 0.005), allowed_time_s=0.5)
    plan = planner.plan(problem)
    assert isinstance(plan, Plan), plan
    assert_touches_nothing(plan.trajectory, collision, start)
    assert planner.plan(PlanningProblem("arm", start, Point("rod", (0, 0, 2.0), 0.005))).code is Code.NO_IK_SOLUTION
    assert Planner(crane, lambda: float(next(ticks))).plan(problem).code is Code.TIMED_OUT


def test_path_constraints_are_kept_all_the_way_around_an_obstacle(robot, setting):
    planner = Planner(robot, time.process_time)
    wall = thing(Box((0.3, 0.02, 0.08)), 0.25, 0.0, 0.04, name="wall")
    assert planner.set_scene(Scene(1, (wall,))) is None
    down = AxisGoal(TIP, (0.22, -0.12, 0.05), 0.002, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.02)
    start = planner.answer(IkQuestion("arm", setting.home(), down)).positions_rad[0]
    level = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.15, 0.15, 3.2)),))
    goal = Point(TIP, (0.22, 0.12, 0.05), 0.005)
    plan = planner.plan(setting.problem(goal, dict(start), path_constraints=level, seed=3))
    assert isinstance(plan, Plan), plan
    assert plan.method == PROJECTED_SEARCH
    assert_keeps_rates(plan.trajectory, setting.scaled_limits(setting.problem(goal)))
    holds = GoalStates(robot, setting.collision).condition_set(level).holds
    assert all(holds(q) for q in configurations(plan.trajectory, setting.collision, start, step_m=0.01))


def test_bad_scene_is_refused_and_the_one_before_stays(robot, setting):
    planner = Planner(robot, time.process_time)
    block = thing(Box((0.1, 0.1, 0.1)), 0.39, 0.0, 0.226, name="block")
    assert planner.set_scene(Scene(1, (block,))) is None
    assert isinstance(planner.set_scene(Scene(2, (block, block))), PlanningFailure)
    failure = planner.plan(setting.problem(JointGoal({"wrist_roll": 0.3})))
    assert failure.code is Code.START_STATE_IN_COLLISION
    assert "block" in failure.message


def test_all_that_is_wrong_with_a_state_is_told(planner, at_home):
    assert planner.answer(StateQuestion("arm", at_home)).problems == ()
    answer = planner.answer(StateQuestion("arm", at_home | FOLDED_DEEP | {"wrist_roll": 3.0}, ROLLED))
    assert not answer.valid
    beyond, contact, violated = answer.problems
    assert (beyond.code, beyond.details["joint"]) == (Code.INVALID_ROBOT_STATE, "wrist_roll")
    assert contact.code is Code.START_STATE_IN_COLLISION
    assert contact.details["pairs"]
    assert violated.code is Code.GOAL_CONSTRAINTS_VIOLATED


@pytest.fixture(scope="module")
def motion(arm):
    """A swing around the pan axis with the arm stretched out."""
    points = np.array([[-1.2, 0.0, 0.0, 0.0, 0.0], [1.2, 0.2, -0.2, 0.3, 0.5]])
    limits = RateLimits(np.full(5, 2.0), np.full(5, 6.0))
    return time_along(NaturalSpline(np.array([0.0, 1.0]), points), arm.joints, limits)


@pytest.fixture
def ask(robot, collision, motion):
    def ask(group="arm", others_rad=(("gripper", 0.0),), from_s=0.0):
        return recheck(RecheckQuestion(group, motion, dict(others_rad), from_s), robot, collision)

    return ask


@pytest.mark.parametrize("angle_rad", [-1.0, -0.4, 0.1, 0.7])
def test_the_first_contact_of_the_rest_is_found(collision, motion, ask, put, angle_rad):
    x, y = (0.3 * np.array([np.cos(angle_rad), np.sin(angle_rad)])).tolist()
    put(collision, thing(Box((0.05, 0.05, 0.8)), x, y, 0.2, name="post"))
    for from_s in (0.0, 0.3 * motion.duration_s, 0.6 * motion.duration_s):
        answer = ask(from_s=from_s)
        times_s = np.linspace(from_s, motion.duration_s, 200)
        touching = [t for t in times_s if collision.in_collision(np.array([*motion.sample(t)[0], 0.0]))]
        assert (answer.contact is not None) == bool(touching)
        if touching:
            assert answer.contact_s == pytest.approx(touching[0], abs=0.03)
            assert answer.contact.code == Code.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
            assert "post" in answer.contact.message


def test_questions_about_no_motion_are_refused(ask):
    for asked, code in (
        ({"group": "leg"}, Code.INVALID_GROUP_NAME),
        ({"group": "gripper"}, Code.INVALID_MOTION_PLAN),
        ({"from_s": -0.1}, Code.INVALID_MOTION_PLAN),
        ({"from_s": float("nan")}, Code.INVALID_MOTION_PLAN),
        ({"others_rad": ()}, Code.START_STATE_INVALID),
    ):
        assert refusal(ask, **asked).code == code, asked


FOLDED_DEEP = {"shoulder_lift": -1.7, "elbow_flex": 1.69, "wrist_flex": 1.2}


def test_configuration_for_a_goal_is_one_by_name_for_every_joint_in_which_the_constraints_hold(setting, at_home):
    wanted_m, ask = (0.25, 0.1, 0.2), setting.planner.answer
    answer = ask(IkQuestion("arm", at_home | {"gripper": 0.3}, Point(TIP, wanted_m, 0.001)))
    (positions_rad,) = answer.positions_rad
    assert set(positions_rad) == set(at_home)
    assert positions_rad["gripper"] == 0.3
    assert np.linalg.norm(np.subtract(setting.tip_m(positions_rad), wanted_m)) <= 0.001
    assert answer.deviations[0].position_m <= 0.001
    answer = ask(IkQuestion("arm", at_home, Point(TIP, wanted_m, 0.001), constraints=ROLLED))
    assert answer.positions_rad[0]["wrist_roll"] == pytest.approx(1.0, abs=0.101)
    # One in contact is an answer only if contacts do not matter.
    deep = JointGoal(FOLDED_DEEP)
    assert ask(IkQuestion("arm", at_home, deep)).code is Code.GOAL_IN_COLLISION
    assert ask(IkQuestion("arm", at_home, deep, avoid_collisions=False)).positions_rad[0]["elbow_flex"] == 1.69


def test_a_budget_and_its_shares_last_until_the_allowed_time_is_spent_or_they_are_asked_to_stop():
    clock = FakeClock()
    budget = Budget(clock, 2.0, lambda: False)
    clock.advance(1.0)
    part = budget.share(0.5)
    assert part.left_s == pytest.approx(0.5)
    clock.advance(0.75)
    assert (part.used_up(), budget.used_up()) == (True, False)
    assert budget.left_s == pytest.approx(0.25)
    clock.advance(0.249)
    assert not budget.used_up()
    clock.advance(0.001)
    assert budget.used_up()
    assert budget.spent_s == pytest.approx(2.0)
    assert budget.failure().code is MoveItErrorCode.TIMED_OUT
    assert "2 s" in budget.failure().message
    stopped = Budget(clock, 2.0, lambda: True)
    assert stopped.used_up()
    assert stopped.share(0.5).used_up()
    assert stopped.failure().code is MoveItErrorCode.PREEMPTED
