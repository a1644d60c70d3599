"""Built-in arms as they are shipped: named states of Fetch and Koch, and pose goals for seven and eight joints."""

import itertools
import time

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.collision import CollisionModel
from planners.goals import PoseGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from planners.scene import Pose
from robot.description import robot_folder
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.robot_folder import built_in

TIP = "gripper_link"

# Poses of the tip in the root link: position [m], and x, y, z, w. Before the robot, to its sides, above and below.
FORWARD = (0.0, 0.0, 0.0, 1.0)
DOWN = (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)
TO_THE_LEFT = (0.0, 0.0, 0.7071067811865476, 0.7071067811865476)
POSES = [
    ((0.75, 0.0, 0.9), FORWARD),
    ((0.6, 0.3, 0.7), DOWN),
    ((0.6, -0.3, 0.7), DOWN),
    ((0.3, 0.6, 0.95), TO_THE_LEFT),
]
POSITION_M, ORIENTATION_RAD = 0.001, 0.005


@pytest.fixture(scope="module")
def fetch() -> RobotModel:
    return robot_folder.built_in("fetch").model


@pytest.fixture(scope="module")
def planner(fetch: RobotModel) -> Planner:
    return Planner(fetch, time.process_time)


def start(fetch: RobotModel) -> dict[str, float]:
    """The arm bent before the robot, the lift down, the gripper closed."""
    at_zero = {joint.name: 0.0 for joint in fetch.movable_joints}
    return {**at_zero, **fetch.named_states["arm"]["ready"]}


def test_its_arm_has_seven_joints_and_with_the_lift_eight(fetch: RobotModel) -> None:
    assert [len(fetch.groups[name].joints) for name in ("arm", "arm_with_torso", "gripper")] == [7, 8, 2]
    assert fetch.groups["arm_with_torso"].joints == ("torso_lift_joint", *fetch.groups["arm"].joints)
    assert fetch.groups["arm"].tip_link == fetch.groups["arm_with_torso"].tip_link == TIP


@pytest.mark.parametrize("group", ["arm", "arm_with_torso", "gripper"])
def test_nothing_touches_in_its_named_states(fetch: RobotModel, group: str) -> None:
    collision = CollisionModel(fetch)
    for name, state in fetch.named_states[group].items():
        positions = {**start(fetch), **state}
        q = np.array([positions[joint] for joint in collision.joint_names])
        assert np.all(q >= collision.lower_rad), name
        assert np.all(q <= collision.upper_rad), name
        assert collision.colliding_pairs(q) == [], name


@pytest.mark.parametrize("group", ["arm", "arm_with_torso"])
def test_it_goes_from_pose_to_pose_with_the_orientation_that_is_asked_for(
    fetch: RobotModel, planner: Planner, group: str
) -> None:
    positions, placements = start(fetch), ForwardPlacements(fetch)
    for point, quaternion in itertools.chain(POSES, POSES[:1]):
        goal = PoseGoal(TIP, Pose(point, quaternion), POSITION_M, (ORIENTATION_RAD,) * 3, strict=True)
        plan = planner.plan(PlanningProblem(group, positions, goal))
        assert isinstance(plan, Plan), plan
        end_rad = plan.trajectory.positions_rad[-1].tolist()
        positions = {**positions, **dict(zip(plan.trajectory.joint_names, end_rad, strict=True))}
        reached = placements.transforms(positions)[TIP]
        np.testing.assert_allclose(reached[:3, 3], point, atol=POSITION_M)
        turned = pin.log3(pin.Quaternion(np.array(quaternion)).matrix().T @ reached[:3, :3])
        assert np.linalg.norm(turned) < 2.0 * ORIENTATION_RAD


KOCH = built_in("koch_v1_1").model
STATES = KOCH.named_states["arm"]


@pytest.fixture(scope="module")
def collisions() -> CollisionModel:
    return CollisionModel(KOCH)


def configuration(collisions: CollisionModel, name: str) -> np.ndarray:
    return np.array([STATES[name].get(joint, 0.0) for joint in collisions.joint_names])


@pytest.mark.parametrize("name", STATES)
def test_a_koch_touches_nothing_at_its_named_states_and_between_them(collisions: CollisionModel, name: str) -> None:
    start, end = configuration(collisions, "home"), configuration(collisions, name)
    assert not any(collisions.collides(start + (end - start) * share) for share in np.linspace(0.0, 1.0, 50))


def test_a_stretched_koch_reaches_as_far_as_its_links_are_long(collisions: CollisionModel) -> None:
    (tip,) = collisions.tip_positions([configuration(collisions, "extended")], "gripper_frame_link")
    # Upper arm 108 mm, forearm 100 mm, wrist 45 mm, fingers 67 mm.
    assert tip[0] == pytest.approx(0.32, abs=0.01)
    assert abs(tip[1]) < 0.01
