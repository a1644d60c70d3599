from __future__ import annotations

from pathlib import Path

import pytest

from robot import model
from server.app import Description, check_parameters
from server.config import ArmSettings
from server.errors import ConfigurationError
from server.moveit.parameters import MoveItParameters


def test_the_default_parameters_fit_the_builtin_arm() -> None:
    check_parameters(MoveItParameters(), model.builtin())


WRONG = {
    "group": (MoveItParameters(group_name="leg"), r"moveit\.group_name.*'leg'.*arm, gripper"),
    "link": (MoveItParameters(end_effector_link="toe"), r"moveit\.end_effector_link.*'toe'.*gripper_frame_link"),
    "frame": (MoveItParameters(planning_frame="world"), r"moveit\.planning_frame.*'base_link'.*'world'"),
}


@pytest.mark.parametrize(("parameters", "words"), WRONG.values(), ids=WRONG.keys())
def test_a_parameter_the_robot_does_not_have_is_named(parameters: MoveItParameters, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        check_parameters(parameters, model.builtin())


def test_another_description_is_read_within_the_calibration(tmp_path: Path) -> None:
    builtin = model.builtin()
    urdf, srdf = tmp_path / "arm.urdf", tmp_path / "arm.srdf"
    urdf.write_text(builtin.urdf.replace('lower="-1.91986"', 'lower="-0.5"'))
    srdf.write_text(builtin.srdf)
    read = Description.read(ArmSettings(urdf=urdf, srdf=srdf))
    assert read.robot.joints["shoulder_pan"].lower == -0.5
    assert read.robot.mesh_directory == tmp_path


def test_a_robot_without_the_calibrated_joints_is_refused(tmp_path: Path) -> None:
    builtin = model.builtin()
    urdf, srdf = tmp_path / "arm.urdf", tmp_path / "arm.srdf"
    urdf.write_text(builtin.urdf.replace("wrist_roll", "wrist_twist"))
    srdf.write_text(builtin.srdf.replace("wrist_roll", "wrist_twist"))
    with pytest.raises(ConfigurationError, match="'wrist_roll'"):
        Description.read(ArmSettings(urdf=urdf, srdf=srdf))
