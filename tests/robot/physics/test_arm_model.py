"""Arms in the physical world."""

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robot.control.loop import hardware_opener
from robot.description import model, robot_folder
from robot.errors import DescriptionError
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import HardwareInterface, run_to_end
from robot.messages import ArmConfig
from robot.physics.arm_model import arm_model, compiled
from robot.physics.ideal_arm import PhysicalArm
from tests.helpers import robots
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import so101


@pytest.mark.parametrize("name", robot_folder.built_in_names())
def test_every_built_in_arm_has_a_model_with_the_masses_and_limits_of_its_urdf(name: str) -> None:
    robot = robot_folder.built_in(name).model
    built = compiled(arm_model(robot))
    assert {joint.name for joint in robot.movable_joints} <= {built.joint(at).name for at in range(built.nv)}
    for joint in robot.movable_joints:
        limits = [0.0, 0.0] if joint.type == "continuous" else [joint.lower, joint.upper]
        assert built.jnt_range[built.joint(joint.name).id].tolist() == pytest.approx(limits)
    assert name != "so101" or float(built.body_mass.sum()) == pytest.approx(0.632, abs=0.001)


def test_links_without_a_mass_have_one_from_their_shapes_which_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    real = so101()
    light = model.parse(re.sub(r"<inertial>.*?</inertial>", "", real.urdf, flags=re.DOTALL), real.srdf)
    with caplog.at_level(logging.WARNING):
        # An arm that cannot be opened is tried again every two seconds.
        arm_model(light)
        built = compiled(arm_model(light))
    assert caplog.messages == [
        "physics: the URDF has no mass of base_link, shoulder_link, upper_arm_link, lower_arm_link, wrist_link, "
        "gripper_link, moving_jaw_so101_v1_link; estimated from the collision shapes at 600 kg/m^3"
    ]
    assert float(built.body_mass.sum()) == pytest.approx(0.632, rel=0.5)
    # A link without mass and shape weighs next to nothing.
    built = compiled(arm_model(model.parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)))
    (turret_kg,) = built.body("turret").mass
    assert 0.0 < turret_kg < 1e-5
    assert float(built.body_mass.sum()) > 0.1


def test_a_mesh_that_mujoco_cannot_read_is_named(tmp_path: Path) -> None:
    for name, text, words in (
        ("base.dae", "<COLLADA/>", r"base\.dae cannot be loaded by physics, only \.stl, \.obj, \.msh"),
        ("base.stl", "nothing", r"cannot be loaded by MuJoCo: .*base\.stl"),
    ):
        mesh = tmp_path / name
        mesh.write_text(text)
        urdf = robots.SEVEN_JOINT_URDF.replace('<cylinder radius="0.06" length="0.1"/>', f'<mesh filename="{mesh}"/>')
        robot = model.parse(urdf, robots.SEVEN_JOINT_SRDF, mesh_directory=tmp_path)
        with pytest.raises(DescriptionError, match=words):
            compiled(arm_model(robot))


def opened(name: str, clock: SteppedClock, **settings: Any) -> HardwareInterface:
    return hardware_opener(ArmConfig(robot_folder.built_in(name).model, IdealConfig(**settings)), clock)()


@pytest.mark.parametrize("name", ["fetch", "so101"])
def test_joints_follow_their_goals_as_without_physics_and_stay_where_they_are_relaxed(name: str) -> None:
    clock = SteppedClock()
    light, physical = opened(name, clock), opened(name, clock, physics=True)
    assert (type(light), type(physical)) == (IdealArm, PhysicalArm)
    count = len(light.joint_names)
    joints = robot_folder.built_in(name).model.joints
    upper = np.array([joints[each].upper for each in light.joint_names])
    goals = {arm: run_to_end(arm.enable(range(count)), clock.advance).copy() for arm in (light, physical)}
    for tick in range(400):
        clock.advance(0.01)
        for arm in (light, physical):
            arm.write_goals(np.minimum(goals[arm] + min(tick, 100) * 0.002, upper))
            arm.read()
    expected, measured = light.read(), physical.read()
    assert measured.position_rad == pytest.approx(expected.position_rad, abs=0.01)
    assert np.abs(measured.velocity_rad_s) == pytest.approx(0.0, abs=0.02)
    # The arm carries its weight without torque, too.
    run_to_end(physical.switch_off(), clock.advance)
    for _ in range(200):
        clock.advance(0.01)
        relaxed = physical.read()
    assert relaxed.position_rad == pytest.approx(measured.position_rad, abs=0.01)
