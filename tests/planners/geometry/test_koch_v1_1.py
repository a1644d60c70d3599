import numpy as np
import pytest

from planners.geometry.collision import CollisionModel
from robot.description.robot_folder import built_in

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
