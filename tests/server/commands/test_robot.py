from pathlib import Path

import pytest

from robot.description import robot_folder
from robot.description.robot_folder import built_in_names
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.stl_arm import write_package
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF


def test_built_in_arms_are_listed_and_shown_with_joints_and_servos(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["robot", "list"]) == ExitCode.DONE
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]] == built_in_names()
    assert cli.main(["robot", "check", "so101"]) == ExitCode.DONE
    printed = capsys.readouterr().out
    assert "elbow_flex     revolute  -1.690 .. 1.690  1.6       5             sts3215, id 3" in printed
    assert "tip gripper_frame_link" in printed
    assert cli.main(["robot", "check", "so102"]) == ExitCode.PROBLEMS
    assert "'so102' is no folder" in capsys.readouterr().out


def test_everything_that_is_wrong_with_a_folder_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.toml").write_text('[robot]\nurd = "x"\n[gripper]\nopen = 1\n')
    assert cli.main(["robot", "check", str(tmp_path)]) == ExitCode.PROBLEMS
    assert capsys.readouterr().out.splitlines() == [
        "robot.urd: there is no such key; did you mean urdf?",
        "gripper.joints: is missing",
        "gripper.closed: is missing",
    ]
    (tmp_path / "robot.toml").write_text("")
    (tmp_path / "crane.srdf").write_text(CRANE_SRDF)
    boom = CRANE_URDF.replace('<box size="0.3 0.02 0.02"/>', '<mesh filename="boom.stl"/>')
    (tmp_path / "crane.urdf").write_text(boom)
    (tmp_path / "boom.stl").write_bytes(bytes(200))
    assert cli.main(["robot", "check", str(tmp_path)]) == ExitCode.PROBLEMS
    assert "boom.stl" in capsys.readouterr().out


def test_an_import_says_what_it_made_and_how_to_serve_it_also_of_packages_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = write_package(tmp_path).rename(tmp_path / "arm.urdf")
    (tmp_path / "packages").mkdir()
    (tmp_path / "mesh_arm").rename(tmp_path / "packages" / "mesh_arm")
    out = tmp_path / "arm"
    arguments = ["robot", "import", str(urdf), "--out", str(out), "--samples", "50", "--no-convex"]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "--package-path" in capsys.readouterr().err
    assert cli.main([*arguments, "--package-path", str(tmp_path / "packages")]) == ExitCode.DONE
    printed = capsys.readouterr()
    assert f"next: armbridge serve --robot {out}" in printed.out
    assert "50 of 50 states" in printed.err
    assert robot_folder.load(out).model.default_group == "arm"


def test_an_import_that_cannot_be_done_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["robot", "import", str(tmp_path / "no.urdf")]) == ExitCode.FAILED
    assert capsys.readouterr().err.startswith(f"armbridge: {tmp_path / 'no.urdf'} cannot be read: ")
