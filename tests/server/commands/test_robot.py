from __future__ import annotations

from pathlib import Path

import pytest

from robot.description.robot_folder import built_in_names
from server.cli import main
from server.commands.terminal import ExitCode


def test_a_sound_folder_is_shown_with_its_joints_and_servos(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "so101"]) == ExitCode.DONE
    printed = capsys.readouterr().out
    assert "elbow_flex     revolute  -1.690 .. 1.690  1.6       5             sts3215, id 3" in printed
    assert "tip gripper_frame_link" in printed
    assert main(["robot", "check", "so102"]) == ExitCode.PROBLEMS
    assert "'so102' is no folder" in capsys.readouterr().out


def test_everything_that_is_wrong_with_a_folder_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.toml").write_text('[robot]\nurd = "x"\n[gripper]\nopen = 1\n')
    assert main(["robot", "check", str(tmp_path)]) == ExitCode.PROBLEMS
    printed = capsys.readouterr().out.splitlines()
    assert printed == [
        "robot.urd: there is no such key; did you mean urdf?",
        "gripper.joints: is missing",
        "gripper.closed: is missing",
    ]


def test_the_built_in_arms_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "list"]) == ExitCode.DONE
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == built_in_names()
