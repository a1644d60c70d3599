import itertools
import shutil
import time

import numpy as np
import pytest

from planners.checks import START_CONTACT_DEPTH_M
from planners.geometry.collision import CollisionModel
from planners.goals import (
    AxisGoal,
    Constraints,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionGoal,
)
from planners.ik.goal_states import GoalStates
from planners.motions.path import PROJECTED_SEARCH
from planners.motions.path_timing import time_along
from planners.motions.spline import NaturalSpline
from planners.pipeline import Planner, recheck
from planners.problem import (
    IkAnswer,
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
from planners.scene import Box, Pose, Scene
from robot.description import model
from robot.description.robot_file import FILE_NAME
from robot.description.robot_folder import BUILT_IN, load
from tests.planners.invariants import (
    BLOCKED_LINES,
    assert_keeps_rates,
    assert_touches_nothing,
    configurations,
    refusal,
)
from tests.planners.scenes import thing
from tests.planners.setting import TIP, end_of
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

# Folded a little too far: the hulls of lower arm and shoulder overlap by some 7 mm, the links themselves do not.
FOLDED = {"shoulder_lift": -1.7, "elbow_flex": 1.65, "wrist_flex": 1.0}


@pytest.mark.parametrize("seed", range(6))
def test_random_joint_goals_are_reached_exactly(setting, seed):
    rng = np.random.default_rng(seed)
    start, goal = setting.random_state(rng), setting.random_state(rng)
    goal_rad = {name: goal[name] for name in setting.joints}
    free_q = np.array([{**goal, "gripper": start["gripper"]}[name] for name in setting.collision.joint_names])
    if setting.collision.in_collision(free_q):
        pytest.skip("the goal collides with the jaw as the start has it")
    scalings = rng.uniform(0.05, 1.0, 2)
    options = {"velocity_scaling": float(scalings[0]), "acceleration_scaling": float(scalings[1])}
    plan = setting.solve(setting.problem(JointGoal(goal_rad), start, **options))
    assert end_of(plan) == goal_rad


@pytest.mark.parametrize("seed", range(6))
def test_random_reachable_points_are_reached_within_tolerance(setting, seed):
    rng = np.random.default_rng(100 + seed)
    start, witness = setting.random_state(rng), setting.random_state(rng)
    goal = PositionGoal(TIP, setting.tip_m(witness), 0.005)
    plan = setting.solve(setting.problem(goal, start))
    assert np.linalg.norm(np.subtract(setting.tip_m(start | end_of(plan)), goal.position_m)) <= goal.tolerance_m


def test_motions_keep_the_jerk_limits_of_a_robot_file(setting, tmp_path):
    """The jerk is the difference quotient of the sampled acceleration."""
    jerk_rad_s3 = dict(zip(setting.joints, (40.0, 30.0, 50.0, 60.0, 70.0), strict=True))
    shutil.copytree(BUILT_IN / "so101", tmp_path / "so101")
    file = tmp_path / "so101" / FILE_NAME
    text = file.read_text()
    for name, limit in jerk_rad_s3.items():
        text = text.replace(f"[joints.{name}]\n", f"[joints.{name}]\nmax_jerk = {limit}\n")
    file.write_text(text)
    start, goal = BLOCKED_LINES[0]
    problem = setting.problem(JointGoal(dict(zip(setting.joints, goal, strict=True))), setting.start(start, 0.0))
    trajectory = Planner(load(file.parent).model, time.process_time).plan(problem).trajectory
    step_s = 0.001
    accelerations = [trajectory.sample(time_s)[2] for time_s in np.arange(0.0, trajectory.duration_s, step_s)]
    jerks = np.abs(np.diff(accelerations, axis=0)).max(axis=0) / step_s
    limits = np.array([jerk_rad_s3[name] for name in trajectory.joint_names])
    assert (jerks <= 1.001 * limits).all()
    assert (jerks >= 0.4 * limits).any()
    assert trajectory.duration_s > setting.planner.plan(problem).trajectory.duration_s


def test_same_problem_and_seed_have_the_same_plan(setting, robot):
    start, goal = BLOCKED_LINES[0]
    problem = setting.problem(
        JointGoal(dict(zip(setting.joints, goal, strict=True))), setting.start(start, 0.0), attempts=2, seed=9
    )
    plans = [
        setting.planner.plan(problem),
        Planner(robot, time.process_time).plan(problem),
        setting.planner.plan(problem),
    ]
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan.trajectory.time_s, plans[0].trajectory.time_s)
        np.testing.assert_array_equal(plan.trajectory.positions_rad, plans[0].trajectory.positions_rad)


@pytest.mark.parametrize(
    "goal", [JointGoal({}), JointGoal({"wrist_roll": 0.0}), PositionGoal(TIP, (0.39, 0.0, 0.226), 0.01)]
)
def test_goal_that_already_holds_needs_no_motion(setting, goal):
    plan = setting.solve(setting.problem(goal))
    assert plan.method == "nothing to do"
    assert plan.trajectory.duration_s == 0.0


def test_a_point_out_of_reach_is_refused_with_its_distance_and_the_nearest_which_can_be_reached(setting):
    failure = setting.planner.plan(setting.problem(PositionGoal(TIP, (0.1, 0.0, 0.15), 0.01)))
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION
    assert "4.1 cm" in failure.message
    assert failure.details["distance_m"] == pytest.approx(0.041, abs=0.001)
    setting.solve(setting.problem(PositionGoal(TIP, tuple(failure.details["nearest_m"]), 0.001)))


def test_start_slightly_beyond_a_limit_moves_from_the_limit(setting):
    upper = setting.robot.joints["wrist_roll"].upper
    problem = setting.problem(JointGoal({"elbow_flex": 0.5}), setting.home(wrist_roll=upper + 0.02))
    plan = setting.planner.plan(problem)
    assert plan.trajectory.positions_rad[0, setting.joints.index("wrist_roll")] == upper


def test_arm_that_touches_itself_in_the_hulls_only_may_leave(setting):
    plan = setting.planner.plan(
        setting.problem(JointGoal({"shoulder_lift": -0.5, "elbow_flex": 0.5}), setting.home(**FOLDED))
    )
    assert isinstance(plan, Plan), plan
    states = list(configurations(plan.trajectory, setting.collision, setting.home(**FOLDED)))
    depths_m = [max((pair.depth_m for pair in setting.collision.colliding_pairs(q)), default=0.0) for q in states[::5]]
    assert 0.0 < depths_m[0] <= START_CONTACT_DEPTH_M
    assert max(depths_m) <= depths_m[0] + 0.0005
    assert depths_m[-1] == 0.0


def test_arm_that_touches_itself_may_stay_but_not_go_deeper(setting):
    assert setting.planner.plan(setting.problem(JointGoal({}), setting.home(**FOLDED))).method == "nothing to do"
    deeper = JointGoal({"shoulder_lift": -1.74, "elbow_flex": 1.69})
    failure = setting.planner.plan(setting.problem(deeper, setting.home(**FOLDED)))
    assert failure.code is MoveItErrorCode.GOAL_IN_COLLISION


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
    assert total > 20
    for last in range(0, total, 1 + total // 8):
        asked = itertools.count()
        answer = setting.planner.answer(requests[kind], lambda: next(asked) >= last)  # noqa: B023
        assert answer.code is MoveItErrorCode.PREEMPTED
        assert next(asked) <= last + 4


def test_lack_of_time_is_timed_out(robot, setting):
    ticks = iter(range(1000))
    slow = Planner(robot, clock=lambda: float(next(ticks)))
    failure = slow.plan(setting.problem(JointGoal({"elbow_flex": 0.5}), allowed_time_s=0.5))
    assert failure.code is MoveItErrorCode.TIMED_OUT


def test_an_arm_of_another_kind_is_planned_for():
    crane = model.parse(CRANE_URDF, CRANE_SRDF)
    planner, collision = Planner(crane, time.process_time), CollisionModel(crane)
    start = {"turn": 0.0, "lift": 0.0, "slide": 0.0}
    plan = planner.plan(PlanningProblem("arm", start, PositionGoal("rod", (0.1, 0.3, 0.3), 0.005)))
    assert isinstance(plan, Plan), plan
    assert_touches_nothing(plan.trajectory, collision, start)
    failure = planner.plan(PlanningProblem("arm", start, PositionGoal("rod", (0.0, 0.0, 2.0), 0.005)))
    assert isinstance(failure, PlanningFailure)
    assert failure.code is MoveItErrorCode.NO_IK_SOLUTION


def test_deviation_of_a_pose_on_five_joints_is_that_of_the_end(setting):
    pose = Pose((0.25, 0.1, 0.2))
    plan = setting.solve(setting.problem(PoseGoal(TIP, pose, 0.005, (0.01, 0.01, 0.01))))
    assert np.linalg.norm(np.subtract(setting.tip_m(setting.home() | end_of(plan)), pose.position_m)) <= 0.005
    assert plan.deviation.position_m <= 0.005
    assert plan.deviation.orientation_rad > 0.1


def test_path_constraints_are_kept_all_the_way_around_an_obstacle(robot, setting):
    planner = Planner(robot, time.process_time)
    states = GoalStates(robot, setting.collision)
    wall = thing(Box((0.3, 0.02, 0.08)), 0.25, 0.0, 0.04, name="wall")
    assert planner.set_scene(Scene(1, (wall,))) is None
    down = AxisGoal(TIP, (0.22, -0.12, 0.05), 0.002, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.02)
    start = planner.answer(IkQuestion("arm", setting.home(), down)).positions_rad[0]
    level = Constraints(orientations=(OrientationConstraint(TIP, (1.0, 0.0, 0.0, 0.0), (0.15, 0.15, 3.2)),))
    goal = PositionGoal(TIP, (0.22, 0.12, 0.05), 0.005)
    plan = planner.plan(setting.problem(goal, dict(start), path_constraints=level, seed=3))
    assert isinstance(plan, Plan), plan
    assert plan.method == PROJECTED_SEARCH
    assert_keeps_rates(plan.trajectory, setting.scaled_limits(setting.problem(goal)))
    holds = states.condition_set(level).holds
    assert all(holds(q) for q in configurations(plan.trajectory, setting.collision, start, step_m=0.01))


def test_start_outside_the_path_constraints_is_refused(setting):
    roll = Constraints(joints=(JointConstraint("wrist_roll", 1.0, 0.1, 0.1),))
    failure = setting.planner.plan(setting.problem(JointGoal({"wrist_roll": 1.0}), path_constraints=roll))
    assert failure.code is MoveItErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS
    assert failure.details["violations"][0]["joint"] == "wrist_roll"


def test_bad_scene_is_refused_and_the_one_before_stays(robot, setting):
    planner = Planner(robot, time.process_time)
    block = thing(Box((0.1, 0.1, 0.1)), 0.39, 0.0, 0.226, name="block")
    assert planner.set_scene(Scene(1, (block,))) is None
    assert isinstance(planner.set_scene(Scene(2, (block, block))), PlanningFailure)
    failure = planner.plan(setting.problem(JointGoal({"wrist_roll": 0.3})))
    assert failure.code is MoveItErrorCode.START_STATE_IN_COLLISION
    assert "block" in failure.message


OTHERS = {"gripper": 0.0}
POINTS = np.array([[-1.2, 0.0, 0.0, 0.0, 0.0], [1.2, 0.2, -0.2, 0.3, 0.5]])


@pytest.fixture(scope="module")
def motion(arm):
    """A swing around the pan axis with the arm stretched out."""
    return time_along(
        NaturalSpline(np.array([0.0, 1.0]), POINTS), arm.joints, RateLimits(np.full(5, 2.0), np.full(5, 6.0))
    )


def ask(robot, collision, motion, from_s=0.0, others=OTHERS, group="arm"):
    return recheck(RecheckQuestion(group, motion, others, from_s), robot, collision)


def post(*position_m, size_m=(0.05, 0.05, 0.8)):
    return thing(Box(size_m), *position_m, name="post")


@pytest.mark.parametrize("angle_rad", [-1.0, -0.4, 0.1, 0.7])
def test_the_first_contact_of_the_rest_is_found(robot, collision, motion, put, angle_rad):
    put(collision, post(float(0.3 * np.cos(angle_rad)), float(0.3 * np.sin(angle_rad)), 0.2))
    for from_s in (0.0, 0.3 * motion.duration_s, 0.6 * motion.duration_s):
        answer = ask(robot, collision, motion, from_s)
        times_s = np.linspace(from_s, motion.duration_s, 200)
        touching = [t for t in times_s if collision.in_collision(np.array([*motion.sample(t)[0], 0.0]))]
        assert (answer.contact is not None) == bool(touching)
        if touching:
            assert answer.contact_s == pytest.approx(touching[0], abs=0.03)
            assert answer.contact.code == MoveItErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
            assert "post" in answer.contact.message


@pytest.mark.parametrize(
    ("asked", "code"),
    [
        ({"group": "leg"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"group": "gripper"}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"from_s": -0.1}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"from_s": float("nan")}, MoveItErrorCode.INVALID_MOTION_PLAN),
        ({"others": {}}, MoveItErrorCode.START_STATE_INVALID),
    ],
)
def test_questions_about_no_motion_are_refused(robot, collision, motion, asked, code):
    assert refusal(ask, robot, collision, motion, **asked).code == code


FOLDED_DEEP = {"shoulder_lift": -1.7, "elbow_flex": 1.69, "wrist_flex": 1.2}


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
    question = IkQuestion("arm", at_home, JointGoal(FOLDED_DEEP))
    assert planner.answer(question).code is MoveItErrorCode.GOAL_IN_COLLISION
    free = planner.answer(IkQuestion("arm", at_home, JointGoal(FOLDED_DEEP), avoid_collisions=False))
    assert free.positions_rad[0]["elbow_flex"] == 1.69


def test_constraints_hold_in_the_answer(planner, at_home):
    roll = Constraints(joints=(JointConstraint("wrist_roll", 1.0, 0.1, 0.1),))
    goal = PositionGoal(TIP, (0.25, 0.1, 0.2), 0.001)
    answer = planner.answer(IkQuestion("arm", at_home, goal, constraints=roll))
    assert answer.positions_rad[0]["wrist_roll"] == pytest.approx(1.0, abs=0.101)


def test_all_that_is_wrong_with_a_state_is_told(planner, at_home):
    assert planner.answer(StateQuestion("arm", at_home)).problems == ()
    wrong = at_home | FOLDED_DEEP | {"wrist_roll": 3.0}
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
