import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.pairs import Rules, held_by, links_of, padding, standing
from planners.geometry.shapes import robot_shapes
from planners.geometry.skeleton import kinematic_urdf
from planners.scene import EMPTY_SCENE, AttachedObject, Box, Pose, Scene, SceneObject

CUBE = SceneObject("cube", ((Box((0.1, 0.1, 0.1)), Pose()),), Pose((0.3, 0.0, 0.0)))
POST = SceneObject("post", ((Box((0.1, 0.1, 0.5)), Pose()),), Pose((0.3, 0.3, 0.0)))
FINGERS = frozenset({"moving_jaw_so101_v1_link"})
HELD = AttachedObject(SceneObject("bar", ((Box((0.02, 0.02, 0.1)), Pose()),)), "gripper_link", FINGERS)
GRIPPER_AND_WRIST = frozenset({"gripper_link", "wrist_link"})


@pytest.fixture(scope="session")
def pin_model(robot):
    return pin.buildModelFromXML(kinematic_urdf(robot))


@pytest.fixture
def bodies(robot, pin_model):
    shapes = robot_shapes(robot, pin_model)

    def build(scene):
        held = [body for attached in scene.attached for body in held_by(pin_model, attached, 1.0)]
        return [*links_of(pin_model, shapes, scene), *held], list(standing(scene, 1.0))

    return build


@pytest.fixture
def checked(robot, bodies):
    """Pairs of names that are checked in a scene."""

    def names(scene):
        movers, around = bodies(scene)
        everything = [*movers, *around]
        pairs = Rules(robot, scene.allowed).pairs(movers, around)
        return {frozenset((everything[i].name, everything[j].name)) for i, j in pairs}

    return names


def test_links_are_checked_but_for_neighbours_and_disabled_pairs(robot, checked):
    neighbours = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
    names = [*robot.hulls]
    every = {frozenset((a, b)) for a in names for b in names if a != b}
    assert checked(EMPTY_SCENE) == every - neighbours - robot.disabled_pairs


def test_objects_are_checked_against_all_links_that_move(robot, checked):
    with_cube = {pair for pair in checked(Scene(1, (CUBE, POST))) if "cube" in pair}
    assert with_cube == {frozenset(("cube", link)) for link in robot.hulls if link != robot.root_link}


def test_what_is_held_is_checked_against_objects_and_links_that_it_may_not_touch(robot, checked):
    with_bar = {pair for pair in checked(Scene(1, (CUBE,), (HELD,))) if "bar" in pair}
    touched = {"gripper_link", *FINGERS}
    assert with_bar == {frozenset(("bar", name)) for name in {*robot.hulls, "cube"} - touched}


@pytest.mark.parametrize("pair", [("cube", "wrist_link"), ("shoulder_link", "gripper_link"), ("bar", "cube")])
def test_an_allowed_pair_is_not_checked(checked, pair):
    scene = Scene(1, (CUBE,), (HELD,))
    allowed = Scene(1, (CUBE,), (HELD,), allowed={frozenset(pair): True})
    assert checked(scene) - checked(allowed) == {frozenset(pair)}


def test_a_pair_said_to_be_forbidden_is_checked_though_its_links_are_neighbours(checked):
    assert GRIPPER_AND_WRIST not in checked(EMPTY_SCENE)
    assert GRIPPER_AND_WRIST in checked(Scene(1, allowed={GRIPPER_AND_WRIST: False}))


def test_padding_is_between_links_and_objects_only(robot, bodies):
    movers, around = bodies(Scene(1, (CUBE,), (HELD,), link_padding_m={"wrist_link": 0.01}))
    everything = [*movers, *around]
    pairs = Rules(robot, {}).pairs(movers, around)
    padded = [
        {everything[i].name, everything[j].name}
        for (i, j), apart_m in zip(pairs, padding(everything, pairs), strict=True)
        if apart_m == 0.01
    ]
    assert padded == [{"wrist_link", "bar"}, {"wrist_link", "cube"}]
    assert np.count_nonzero(padding(everything, pairs)) == 2


def test_a_scaled_link_meets_objects_in_its_new_size_and_links_in_its_own(robot, bodies):
    movers, around = bodies(Scene(1, (CUBE,), link_scale={"wrist_link": 2.0}))
    own, larger = [body for body in movers if body.name == "wrist_link"]
    assert larger.shape.geometry.computeVolume() == pytest.approx(8.0 * own.shape.geometry.computeVolume())
    everything = [*movers, *around]
    met = {own: set(), larger: set()}
    for i, j in Rules(robot, {}).pairs(movers, around):
        for one, other in ((everything[i], everything[j]), (everything[j], everything[i])):
            if one in met:
                met[one].add(other.name)
    assert met[larger] == {"cube"}
    assert "cube" not in met[own]
    assert met[own]
