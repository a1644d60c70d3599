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


@pytest.fixture
def crane():
    return model.parse(CRANE_URDF, CRANE_SRDF)


def test_continuous_joints_get_one_turn_either_way(crane):
    model_of_crane = pin.buildModelFromXML(kinematic_urdf(crane))
    assert model_of_crane.nq == model_of_crane.nv == 3
    turn = model_of_crane.joints[model_of_crane.getJointId("turn")].idx_q
    assert model_of_crane.lowerPositionLimit[turn] == pytest.approx(-math.pi)
    assert model_of_crane.upperPositionLimit[turn] == pytest.approx(math.pi)


def test_joints_may_come_in_any_order(robot, collision):
    names = collision.joint_names
    forward, backward = ForwardKinematics(robot, names), ForwardKinematics(robot, names[::-1])
    q = np.linspace(-0.5, 0.5, 6)
    forward.place(q)
    backward.place(q[::-1])
    for link in robot.links:
        np.testing.assert_array_equal(forward.placement(link).homogeneous, backward.placement(link).homogeneous)


def test_limits_are_those_of_the_model(robot):
    elbow = dataclasses.replace(robot.joints["elbow_flex"], lower=-0.5, upper=0.25)
    narrow = dataclasses.replace(robot, joints={**robot.joints, "elbow_flex": elbow})
    kinematics = pin.buildModelFromXML(kinematic_urdf(narrow))
    column = kinematics.joints[kinematics.getJointId("elbow_flex")].idx_q
    assert (kinematics.lowerPositionLimit[column], kinematics.upperPositionLimit[column]) == (-0.5, 0.25)


ARMS = {"so101": so101, "crane": lambda: model.parse(CRANE_URDF, CRANE_SRDF)}


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

    def moves(self, seed, count, widest_rad):
        """Configurations and what is added to each."""
        rng = np.random.default_rng(seed)
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        for _ in range(count):
            q = rng.uniform(lower, upper)
            dq = rng.uniform(-widest_rad, widest_rad, len(q)) * rng.integers(0, 2, len(q))
            yield q, np.clip(q + dq, lower, upper) - q


@pytest.fixture(params=sorted(ARMS))
def arm(request):
    return Arm(ARMS[request.param]())


def test_no_point_of_a_shape_moves_further_than_the_bound(arm):
    reach_m = arm.reach.of_shapes(arm.shapes)
    for q, dq in arm.moves(2, 300, 0.2):
        for before, after, bound_m in zip(arm.points(q), arm.points(q + dq), reach_m @ np.abs(dq), strict=True):
            assert np.linalg.norm(after - before, axis=1).max() <= bound_m + 1e-12


def test_no_frame_moves_further_than_the_bound(arm):
    reach_m, data = arm.reach.of_frames(), arm.model.createData()
    for q, dq in arm.moves(4, 100, 0.2):
        placed = []
        for state in (q, q + dq):
            pin.forwardKinematics(arm.model, data, state)
            frames = [pin.updateFramePlacement(arm.model, data, i) for i in range(len(reach_m))]
            placed.append(np.array([frame.translation.copy() for frame in frames]))
        assert np.all(np.linalg.norm(placed[1] - placed[0], axis=1) <= reach_m @ np.abs(dq) + 1e-12)


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
        margins_m = collision.margins_m(np.abs(dq)[np.newaxis])[0]
        assert np.all((distances_m[0] - distances_m[1] <= margins_m + 1e-6)[apart])


def test_nothing_is_further_from_the_root_than_the_bound(arm):
    farthest_m = max(arm.reach.farthest_m(shape) for shape in arm.shapes)
    for q, _ in arm.moves(7, 100, 0.0):
        assert np.linalg.norm(np.vstack(arm.points(q)), axis=1).max() <= farthest_m
