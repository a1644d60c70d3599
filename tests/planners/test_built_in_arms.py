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
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.robot_folder import built_in
from tests.planners.scenes import tip_positions_m

FETCH, KOCH = built_in("fetch").model, built_in("koch_v1_1").model
TIP = "gripper_link"

# The arm bent before the robot, the lift down, the gripper closed.
START_RAD = {**dict.fromkeys((joint.name for joint in FETCH.movable_joints), 0.0), **FETCH.named_states["arm"]["ready"]}

# Poses of the tip in the root link: position [m], and x, y, z, w. Before the robot, to its sides, above and below.
FORWARD, HALF = (0.0, 0.0, 0.0, 1.0), 0.5**0.5
DOWN, TO_THE_LEFT = (0.0, HALF, 0.0, HALF), (0.0, 0.0, HALF, HALF)
POSES = [((0.75, 0, 0.9), FORWARD), ((0.6, 0.3, 0.7), DOWN), ((0.6, -0.3, 0.7), DOWN), ((0.3, 0.6, 0.95), TO_THE_LEFT)]
POSITION_M, ORIENTATION_RAD = 0.001, 0.005


def test_the_arm_of_a_fetch_has_seven_joints_and_with_the_lift_eight_and_touches_nothing_in_its_named_states() -> None:
    arm, with_torso, gripper = (FETCH.groups[name] for name in ("arm", "arm_with_torso", "gripper"))
    assert (len(arm.joints), len(gripper.joints)) == (7, 2)
    assert with_torso.joints == ("torso_lift_joint", *arm.joints)
    assert arm.tip_link == with_torso.tip_link == TIP
    collision = CollisionModel(FETCH)
    for group in ("arm", "arm_with_torso", "gripper"):
        for name, state in FETCH.named_states[group].items():
            q = np.array([{**START_RAD, **state}[joint] for joint in collision.joint_names])
            assert np.all((collision.lower_rad <= q) & (q <= collision.upper_rad)), name
            assert collision.colliding_pairs(q) == [], name


@pytest.mark.parametrize("group", ["arm", "arm_with_torso"])
def test_it_goes_from_pose_to_pose_with_the_orientation_that_is_asked_for(group: str) -> None:
    planner, positions, placements = Planner(FETCH, time.process_time), START_RAD, ForwardPlacements(FETCH)
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
