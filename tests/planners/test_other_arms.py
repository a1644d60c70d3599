"""Arms other than the SO-101: built in, with mimic joints, and several in one model."""

import itertools
import time

import numpy as np
import pinocchio as pin
import pytest

from planners import problem
from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics
from planners.goals import JointGoal, PoseGoal, PositionGoal
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode as Code
from planners.scene import Box, Pose
from planners.servo.question import JointVelocities, ServoLimits, ServoQuestion
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.joined import PlacedArm, joined, prefixed
from robot.description.robot_folder import built_in
from tests.helpers.robots import so101
from tests.planners.scenes import thing, tip_positions_m
from tests.planners.small_arms import PALLETIZER_SRDF, PALLETIZER_URDF

FETCH, KOCH = built_in("fetch").model, built_in("koch_v1_1").model
FETCH_TIP = "gripper_link"

# The arm bent before the robot, the lift down, the gripper closed.
FETCH_START_RAD = {
    **dict.fromkeys((joint.name for joint in FETCH.movable_joints), 0.0),
    **FETCH.named_states["arm"]["ready"],
}

# Poses of the tip in the root link: position [m], and x, y, z, w. Before the robot, to its sides, above and below.
FORWARD, HALF = (0.0, 0.0, 0.0, 1.0), 0.5**0.5
DOWN, TO_THE_LEFT = (0.0, HALF, 0.0, HALF), (0.0, 0.0, HALF, HALF)
POSES = [((0.75, 0, 0.9), FORWARD), ((0.6, 0.3, 0.7), DOWN), ((0.6, -0.3, 0.7), DOWN), ((0.3, 0.6, 0.95), TO_THE_LEFT)]
POSITION_M, ORIENTATION_RAD = 0.001, 0.005


def test_the_arm_of_a_fetch_has_seven_joints_and_with_the_lift_eight_and_touches_nothing_in_its_named_states() -> None:
    arm, with_torso, gripper = (FETCH.groups[name] for name in ("arm", "arm_with_torso", "gripper"))
    assert (len(arm.joints), len(gripper.joints)) == (7, 2)
    assert with_torso.joints == ("torso_lift_joint", *arm.joints)
    assert arm.tip_link == with_torso.tip_link == FETCH_TIP
    collision = CollisionModel(FETCH)
    for group in ("arm", "arm_with_torso", "gripper"):
        for name, state in FETCH.named_states[group].items():
            q = np.array([{**FETCH_START_RAD, **state}[joint] for joint in collision.joint_names])
            assert np.all((collision.lower_rad <= q) & (q <= collision.upper_rad)), name
            assert collision.colliding_pairs(q) == [], name


@pytest.mark.parametrize("group", ["arm", "arm_with_torso"])
def test_it_goes_from_pose_to_pose_with_the_orientation_that_is_asked_for(group: str) -> None:
    planner, positions, placements = Planner(FETCH, time.process_time), FETCH_START_RAD, ForwardPlacements(FETCH)
    for point, quaternion in itertools.chain(POSES, POSES[:1]):
        goal = PoseGoal(FETCH_TIP, Pose(point, quaternion), POSITION_M, (ORIENTATION_RAD,) * 3, strict=True)
        plan = planner.plan(problem.PlanningProblem(group, positions, goal))
        assert isinstance(plan, problem.Plan), plan
        end_rad = plan.trajectory.positions_rad[-1].tolist()
        positions = {**positions, **dict(zip(plan.trajectory.joint_names, end_rad, strict=True))}
        reached = placements.transforms(positions)[FETCH_TIP]
        np.testing.assert_allclose(reached[:3, 3], point, atol=POSITION_M)
        turned = pin.log3(pin.Quaternion(np.array(quaternion)).matrix().T @ reached[:3, :3])
        assert np.linalg.norm(turned) < 2.0 * ORIENTATION_RAD


def test_a_koch_touches_nothing_at_and_between_its_named_states_and_reaches_as_far_as_its_links_are_long() -> None:
    collision = CollisionModel(KOCH)
    named = KOCH.named_states["arm"]
    states = {
        name: np.array([state.get(joint, 0.0) for joint in collision.joint_names]) for name, state in named.items()
    }
    for name, end in states.items():
        way = states["home"] + np.linspace(0.0, 1.0, 50)[:, np.newaxis] * (end - states["home"])
        assert not any(map(collision.collides, way)), name
    (tip,) = tip_positions_m(collision, [states["extended"]], "gripper_frame_link")
    # Upper arm 108 mm, forearm 100 mm, wrist 45 mm, fingers 67 mm.
    assert tip[:2] == pytest.approx([0.32, 0.0], abs=0.01)


PALLETIZER = model.parse(PALLETIZER_URDF, PALLETIZER_SRDF)
NAMES = ("turn", "boom", "grip")
PALLETIZER_FORWARD = ForwardKinematics(PALLETIZER, NAMES)
STATES = np.random.default_rng(1).uniform(-1.0, 1.0, (20, len(NAMES)))


@pytest.fixture
def collision():
    return CollisionModel(PALLETIZER)


@pytest.fixture(scope="module")
def palletizer_planner():
    return Planner(PALLETIZER, time.process_time)


def place_m(q, link):
    PALLETIZER_FORWARD.place(q)
    return PALLETIZER_FORWARD.placement(link).translation.copy()


def test_the_jacobian_counts_what_follows_and_no_point_travels_further_than_is_said(collision):
    step_rad = 1e-6
    for q in STATES[:5]:
        for link in ("wrist", "right"):
            moved_m = [place_m(q + step, link) - place_m(q - step, link) for step in step_rad * np.eye(len(NAMES))]
            slopes = np.array(moved_m).T / (2.0 * step_rad)
            np.testing.assert_allclose(PALLETIZER_FORWARD.jacobian(q, link)[:3], slopes, atol=1e-8)
    for q in STATES:
        for column, step in enumerate(step_rad * np.eye(len(NAMES))):
            for link in ("wrist", "left", "right"):
                start_m, end_m = PALLETIZER_FORWARD.placements([q, q + step], link).positions_m
                most_m = collision.travel_m_per_rad[column] * step_rad * (1.0 + 1e-6)
                assert np.linalg.norm(end_m - start_m) <= most_m


def test_fingers_that_close_on_each_other_touch_and_are_said_to_come_nearer(collision):
    apart, way = np.zeros(3), 0.6 * (np.array(collision.joint_names) == "grip")
    assert frozenset(("left", "right")) in {pair.links for pair in collision.colliding_pairs(apart - way)}
    assert not collision.in_collision(apart)
    assert collision.near(apart, collision.approach_m_per_rad @ way)


def test_a_wrist_that_follows_reaches_goals_and_a_finger_touches_what_is_in_its_way(palletizer_planner, put):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        wanted_m = place_m(np.array([rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 0.1), 0.0]), "wrist")
        goal = PositionGoal("wrist", tuple(wanted_m.tolist()), 0.001)
        plan = palletizer_planner.plan(problem.PlanningProblem("arm", dict.fromkeys(NAMES, 0.0), goal))
        assert isinstance(plan, problem.Plan), plan
        ends = dict(zip(plan.trajectory.joint_names, plan.trajectory.positions_rad[-1].tolist(), strict=True))
        reached_m = place_m(np.array([ends.get(name, 0.0) for name in NAMES]), "wrist")
        assert np.linalg.norm(reached_m - wanted_m) <= 0.001
    grip = problem.PlanningProblem("hand", dict.fromkeys(NAMES, 0.0), JointGoal({"grip": 1.0}))
    assert isinstance(palletizer_planner.plan(grip), problem.Plan)
    put(palletizer_planner, thing(Box((0.02, 0.02, 0.2)), 0.47, -0.055, 0.12))
    answer = palletizer_planner.plan(grip)
    assert not isinstance(answer, problem.Plan)
    assert "right" in answer.message


ONE = so101()
SIDES = {"left": 0.4, "right": -0.4}
PLACED = {side: PlacedArm(prefixed(ONE, side), base_xyz_m=(0.0, y_m, 0.0)) for side, y_m in SIDES.items()}
PAIR = joined("pair", PLACED)
LEFT = tuple(f"left_{name}" for name in ONE.groups["arm"].joints)
LEFT_TIP = "left_gripper_frame_link"

# The forearm is 50 mm deep in the base.
SAGGING = {"shoulder_lift": 1.36, "elbow_flex": 1.47, "wrist_flex": -0.47}
PAIR_START_RAD = dict.fromkeys((joint.name for joint in PAIR.movable_joints), 0.0) | {
    f"right_{name}": value for name, value in SAGGING.items()
}
GOAL_RAD = dict(zip(LEFT, (0.6, -0.4, 0.3, 0.2, 0.5), strict=True))


@pytest.fixture(scope="module")
def pair_planner() -> Planner:
    return Planner(PAIR, time.process_time)


def test_the_other_arm_moves_and_its_motion_is_free_on_the_way(pair_planner: Planner) -> None:
    plan = pair_planner.answer(problem.PlanningProblem("left_arm", PAIR_START_RAD, JointGoal(GOAL_RAD)))
    assert isinstance(plan, problem.Plan), plan
    assert np.allclose(plan.trajectory.positions_rad[-1], list(GOAL_RAD.values()))
    others = {name: value for name, value in PAIR_START_RAD.items() if name not in LEFT}
    question = problem.RecheckQuestion("left_arm", plan.trajectory, others, 0.1)
    assert pair_planner.answer(question) == problem.RecheckAnswer(None)


def test_questions_about_the_other_arm_are_answered(pair_planner: Planner) -> None:
    assert isinstance(
        pair_planner.answer(problem.IkQuestion("left_arm", PAIR_START_RAD, JointGoal(GOAL_RAD))), problem.IkAnswer
    )
    points = np.array([[0.0] * 5, [0.2] * 5])
    assert isinstance(
        pair_planner.answer(problem.JointPathProblem(PAIR_START_RAD, LEFT, np.array([0.0, 2.0]), points)), problem.Plan
    )
    command = JointVelocities({"left_shoulder_pan": 0.3})
    steered = pair_planner.answer(
        ServoQuestion("left_arm", LEFT_TIP, PAIR_START_RAD, {}, 0.02, command, None, ServoLimits())
    )
    assert steered.velocity_rad_s["left_shoulder_pan"] > 0.0
    x, y, z = ForwardPlacements(PAIR).transforms(PAIR_START_RAD)[LEFT_TIP][:3, 3].tolist()
    line = problem.Line(Pose((x - 0.05, y, z), (0.0, 0.0, 0.0, 1.0)))
    followed = pair_planner.answer(problem.CartesianProblem("left_arm", PAIR_START_RAD, LEFT_TIP, (line,)))
    assert isinstance(followed, problem.CartesianPlan), followed
    assert followed.fraction > 0.9


def test_the_arm_that_sags_does_not_move_out_of_a_deep_contact_nor_the_other_into_one(pair_planner) -> None:
    for group in ("right_arm", "both_arms"):
        goal_rad = dict.fromkeys(PAIR.groups[group].joints, 0.1)
        found = pair_planner.answer(problem.PlanningProblem(group, PAIR_START_RAD, JointGoal(goal_rad)))
        assert found.code is Code.START_STATE_IN_COLLISION
    state = pair_planner.answer(problem.StateQuestion("left_arm", PAIR_START_RAD))
    assert not state.valid
    assert "right_base_link and right_wrist_link by 51" in state.problems[0].message
    goal_rad = GOAL_RAD | {f"left_{name}": value for name, value in SAGGING.items()}
    found = pair_planner.answer(problem.PlanningProblem("left_arm", PAIR_START_RAD, JointGoal(goal_rad)))
    assert found.code is Code.GOAL_IN_COLLISION
