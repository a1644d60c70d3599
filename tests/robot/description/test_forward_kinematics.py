import numpy as np
import pytest

from planners.geometry.kinematics import ForwardKinematics
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from tests.helpers.robots import so101
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

ARMS = {"so101": so101(), "crane": model.parse(CRANE_URDF, CRANE_SRDF)}


@pytest.fixture(params=ARMS)
def arm(request):
    return ARMS[request.param]


def drawn(arm, rng):
    return {joint.name: rng.uniform(joint.lower, joint.upper) for joint in arm.movable_joints}


def test_every_link_is_where_pinocchio_has_it(arm):
    names = [joint.name for joint in arm.movable_joints]
    kinematics, rng = ForwardKinematics(arm, names), np.random.default_rng(3)
    for _ in range(20):
        positions = drawn(arm, rng)
        kinematics.place(np.array([positions[name] for name in names]))
        for link, transform in ForwardPlacements(arm).transforms(positions).items():
            assert transform == pytest.approx(kinematics.placement(link).homogeneous, abs=1e-9)


def test_a_link_stands_on_its_parent(arm):
    placements, positions = ForwardPlacements(arm), drawn(arm, np.random.default_rng(4))
    placed = placements.transforms(positions)
    for link in set(arm.links) - {arm.root_link}:
        parent, transform_link_to_parent = placements.joint_transform(link, positions)
        assert placed[parent] @ transform_link_to_parent == pytest.approx(placed[link], abs=1e-12)


def test_the_root_link_stands_on_nothing(arm):
    with pytest.raises(KeyError):
        ForwardPlacements(arm).joint_transform(arm.root_link, {})
