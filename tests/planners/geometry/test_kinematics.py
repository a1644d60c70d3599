import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.collision import CollisionModel
from planners.geometry.kinematics import ForwardKinematics, Reach
from planners.geometry.shapes import kinematic_urdf, outline, robot_shapes
from robot.description import model
from tests.helpers.robots import so101
from tests.planners.scenes import around_the_arm
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

CRANE = model.parse(CRANE_URDF, CRANE_SRDF)


def test_limits_are_those_of_the_model_and_continuous_joints_get_one_turn_either_way(robot):
    elbow = dataclasses.replace(robot.joints["elbow_flex"], lower=-0.5, upper=0.25)
    narrow = dataclasses.replace(robot, joints={**robot.joints, "elbow_flex": elbow})
    for arm, joint, limits in ((narrow, "elbow_flex", (-0.5, 0.25)), (CRANE, "turn", (-math.pi, math.pi))):
        kinematics = pin.buildModelFromXML(kinematic_urdf(arm))
        assert kinematics.nq == kinematics.nv == len(arm.movable_joints)
        column = kinematics.joints[kinematics.getJointId(joint)].idx_q
        found = kinematics.lowerPositionLimit[column], kinematics.upperPositionLimit[column]
        assert found == pytest.approx(limits)


def test_joints_may_come_in_any_order(robot, collision):
    names = collision.joint_names
    forward, backward = ForwardKinematics(robot, names), ForwardKinematics(robot, names[::-1])
    q = np.linspace(-0.5, 0.5, 6)
    forward.place(q)
    backward.place(q[::-1])
    for link in robot.links:
        np.testing.assert_array_equal(forward.placement(link).homogeneous, backward.placement(link).homogeneous)


class Arm:
    """Positions of all points of an arm's shapes."""

    def __init__(self, robot_model):
        self.robot = robot_model
        self.model = pin.buildModelFromXML(kinematic_urdf(robot_model))
        self.shapes = robot_shapes(robot_model, self.model)
        self.reach = Reach(self.model)
        self._data = self.model.createData()
        self._outlines = [(shape.parentJoint, outline(shape)) for shape in self.shapes]

    def points(self, q):
        """Of each shape, shape (n, 3) [m]."""
        pin.forwardKinematics(self.model, self._data, q)
        return [points @ self._data.oMi[j].rotation.T + self._data.oMi[j].translation for j, points in self._outlines]

    def frames(self, q):
        """Positions of all frames [m]."""
        pin.forwardKinematics(self.model, self._data, q)
        count = len(self.model.frames)
        return np.array([pin.updateFramePlacement(self.model, self._data, i).translation.copy() for i in range(count)])

    def moves(self, seed, count, widest_rad):
        """Configurations and what is added to each."""
        rng = np.random.default_rng(seed)
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        for _ in range(count):
            q = rng.uniform(lower, upper)
            dq = rng.uniform(-widest_rad, widest_rad, len(q)) * rng.integers(0, 2, len(q))
            yield q, np.clip(q + dq, lower, upper) - q


@pytest.fixture(params=[so101, lambda: CRANE], ids=["so101", "crane"])
def arm(request):
    return Arm(request.param())


def test_no_point_of_a_shape_and_no_frame_moves_further_than_the_bound_or_is_further_from_the_root(arm):
    reach_m, frames_reach_m = arm.reach.of_shapes(arm.shapes), arm.reach.of_frames()
    farthest_m = max(arm.reach.farthest_m(shape) for shape in arm.shapes)
    for q, dq in arm.moves(2, 300, 0.2):
        points_m = arm.points(q)
        assert np.linalg.norm(np.vstack(points_m), axis=1).max() <= farthest_m
        for before, after, bound_m in zip(points_m, arm.points(q + dq), reach_m @ np.abs(dq), strict=True):
            assert np.linalg.norm(after - before, axis=1).max() <= bound_m + 1e-12
        moved_m = np.linalg.norm(arm.frames(q + dq) - arm.frames(q), axis=1)
        assert np.all(moved_m <= frames_reach_m @ np.abs(dq) + 1e-12)


def test_no_pair_comes_nearer_than_the_bound(arm):
    collision = CollisionModel(arm.robot)
    collision.set_scene(around_the_arm(5))
    broadphase, pairs = collision._broadphase, range(len(collision._names))
    for q, dq in arm.moves(6, 100, 0.1):
        distances_m = []
        for state in (q, q + dq):
            broadphase.place(state)
            distances_m.append(np.array([broadphase.distance_m(pair) for pair in pairs]))
        apart = distances_m[1] > 0.0
        margins_m = collision.approach_m_per_rad @ np.abs(dq)
        assert np.all((distances_m[0] - distances_m[1] <= margins_m + 1e-6)[apart])
