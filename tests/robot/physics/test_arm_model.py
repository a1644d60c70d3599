import logging
import re
from pathlib import Path

import pytest

from robot.description import model, robot_folder
from robot.errors import DescriptionError
from robot.physics.arm_model import arm_model, compiled
from tests.helpers import robots
from tests.helpers.robots import so101


def without_masses(urdf: str) -> str:
    return re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL)


def test_masses_and_limits_are_those_of_the_urdf() -> None:
    built = compiled(arm_model(so101()))
    assert float(built.body_mass.sum()) == pytest.approx(0.632, abs=0.001)
    joints = {name: so101().joints[name] for name in ("shoulder_pan", "gripper")}
    for name, joint in joints.items():
        assert built.jnt_range[built.joint(name).id].tolist() == pytest.approx([joint.lower, joint.upper])


@pytest.mark.parametrize("name", robot_folder.built_in_names())
def test_every_built_in_arm_has_a_model(name: str) -> None:
    robot = robot_folder.built_in(name).model
    built = compiled(arm_model(robot))
    assert {joint.name for joint in robot.movable_joints} <= {built.joint(at).name for at in range(built.nv)}


def test_links_without_a_mass_have_one_from_their_shapes_which_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    real = so101()
    light = model.parse(without_masses(real.urdf), real.srdf)
    with caplog.at_level(logging.WARNING):
        # An arm that cannot be opened is tried again every two seconds.
        arm_model(light)
        built = compiled(arm_model(light))
    assert caplog.messages == [
        "physics: the URDF has no mass of base_link, shoulder_link, upper_arm_link, lower_arm_link, wrist_link, "
        "gripper_link, moving_jaw_so101_v1_link; estimated from the collision shapes at 600 kg/m^3"
    ]
    assert float(built.body_mass.sum()) == pytest.approx(0.632, rel=0.5)


def test_a_link_without_mass_and_shape_weighs_next_to_nothing() -> None:
    built = compiled(arm_model(model.parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)))
    (turret_kg,) = built.body("turret").mass
    assert 0.0 < turret_kg < 1e-5
    assert float(built.body_mass.sum()) > 0.1


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("base.dae", "<COLLADA/>", r"base\.dae cannot be loaded by physics, only \.stl, \.obj, \.msh"),
        ("base.stl", "nothing", r"cannot be loaded by MuJoCo: .*base\.stl"),
    ],
)
def test_a_mesh_that_mujoco_cannot_read_is_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    mesh = tmp_path / name
    mesh.write_text(text)
    urdf = robots.SEVEN_JOINT_URDF.replace('<cylinder radius="0.06" length="0.1"/>', f'<mesh filename="{mesh}"/>')
    robot = model.parse(urdf, robots.SEVEN_JOINT_SRDF, mesh_directory=tmp_path)
    with pytest.raises(DescriptionError, match=words):
        compiled(arm_model(robot))
