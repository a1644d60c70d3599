from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path

import pytest

from robot import model
from robot.calibration import Calibration
from robot.calibration_files import new_calibration_path, save
from robot.guard_limits import GuardLimits
from robot.messages import EmergencyPolicy, EndState
from server.arm_guard_settings import GuardSettings
from server.arm_setup import Description, arm_config, check_parameters
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


def test_a_trim_of_a_zero_moves_the_limits_of_its_joint() -> None:
    plain = Description.read(ArmSettings()).calibration.joints[2]
    trimmed = Description.read(ArmSettings(zero_offset_rad={"elbow_flex": 0.02})).calibration.joints[2]
    assert trimmed.rad_from_ticks(2000) == pytest.approx(plain.rad_from_ticks(2000) + 0.02)


def test_a_trim_of_an_unknown_joint_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"elbow.*one of the arm's joints"):
        Description.read(ArmSettings(zero_offset_rad={"elbow": 0.02}))


def test_a_calibration_is_found_by_the_id_that_lerobot_has_it_under(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    file = new_calibration_path("my_arm", os.environ)
    save(Calibration.nominal(), file)
    read = Description.read(ArmSettings(calibration=Path("my_arm")))
    assert (read.calibration, read.calibration_file) == (Calibration.nominal(), file)


def test_the_arm_process_gets_what_is_set() -> None:
    guards = GuardSettings(stall_time_s=0.5)
    settings = ArmSettings(
        watchdog_s=1.5, on_exit=EndState.RELAX, on_emergency_stop=EmergencyPolicy.HOLD, guards=guards
    )
    config = arm_config(settings, Description.read(settings), "/dev/arm")
    assert (config.port, config.watchdog_s, config.on_exit) == ("/dev/arm", 1.5, EndState.RELAX)
    assert config.on_emergency_stop is EmergencyPolicy.HOLD
    assert config.guard_limits == GuardLimits(stall_time_s=0.5)
    shared = {field.name for field in fields(config)} & set(ArmSettings.model_fields) - {"calibration"}
    assert {name: getattr(config, name) for name in shared} == {name: getattr(settings, name) for name in shared}
