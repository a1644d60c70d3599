import numpy as np
import pinocchio as pin
import pytest

from planners.shapes import collision_geometry, outline
from planners.skeleton import kinematic_urdf
from planners.travel import travel_per_joint
from robot import model
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

ARMS = {"so101": model.builtin, "crane": lambda: model.parse(CRANE_URDF, CRANE_SRDF)}


class Arm:
    """Where all points of an arm's shapes are."""

    def __init__(self, robot_model):
        self.model = pin.buildModelFromXML(kinematic_urdf(robot_model))
        self.geometry = collision_geometry(robot_model, self.model)
        self._data = self.model.createData()
        self._outlines = [(shape.parentJoint, outline(shape)) for shape in self.geometry.geometryObjects]

    def points(self, q):
        pin.forwardKinematics(self.model, self._data, q)
        placed = [points @ self._data.oMi[j].rotation.T + self._data.oMi[j].translation for j, points in self._outlines]
        return np.vstack(placed)


@pytest.fixture(params=sorted(ARMS))
def arm(request):
    return Arm(ARMS[request.param]())


def test_no_point_of_the_robot_moves_further_than_the_bound(arm):
    weights = travel_per_joint(arm.model, arm.geometry)
    rng = np.random.default_rng(2)
    lower, upper = arm.model.lowerPositionLimit, arm.model.upperPositionLimit
    for _ in range(300):
        q = rng.uniform(lower, upper)
        dq = rng.uniform(-0.01, 0.01, len(q)) * rng.integers(0, 2, len(q))
        moved = np.linalg.norm(arm.points(np.clip(q + dq, lower, upper)) - arm.points(q), axis=1).max()
        assert moved <= weights @ np.abs(dq) + 1e-12


def test_bound_is_nearly_reached_in_some_configuration(arm):
    weights = travel_per_joint(arm.model, arm.geometry)
    rng = np.random.default_rng(3)
    states = rng.uniform(arm.model.lowerPositionLimit, arm.model.upperPositionLimit, (400, arm.model.nv))
    for joint, weight in enumerate(weights):
        step = np.eye(arm.model.nv)[joint] * 1e-4
        moved = max(np.linalg.norm(arm.points(q + step) - arm.points(q), axis=1).max() for q in states)
        assert weight <= 1.25 * moved / 1e-4
