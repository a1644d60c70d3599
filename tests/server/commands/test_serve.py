import re
import sys
from pathlib import Path

import pytest

from server import cli
from server.app import App
from server.commands.terminal import ExitCode
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.server.recordings import record, text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--calibration", "nobodys"], "nobodys"),
        (["--port", "70000"], "server.port"),
        (["--urdf", "a.urdf"], "urdf and srdf must be given together"),
        (["--urdf", "/nowhere.urdf", "--srdf", "/nowhere.srdf"], "/nowhere.urdf cannot be read"),
        (["--config", "/nowhere.toml"], "/nowhere.toml cannot be read"),
    ],
)
def test_a_wrong_setting_is_one_line_and_exit_2(arguments, words, capsys):
    assert cli.main(["serve", *arguments]) == ExitCode.USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


SECOND_LIMIT = '<limit lower="-1.9" upper="1.9" velocity="2" effort="9"/>'

NO_ARM = {
    "no joint that moves": (
        re.sub(r"<axis[^>]*><limit[^>]*>", "", SEVEN_JOINT_URDF).replace('"revolute"', '"fixed"'),
        "URDF {urdf} has no movable joint: no <joint> has the type revolute, continuous or prismatic",
    ),
    "no limit": (SEVEN_JOINT_URDF.replace(SECOND_LIMIT, ""), "URDF {urdf} joint 'a2' has no <limit>: add <limit "),
    "no range": (
        SEVEN_JOINT_URDF.replace('lower="-1.9" upper="1.9" ', ""),
        "URDF {urdf} joint 'a2' <limit> lower 0 must be below upper 0",
    ),
    "no speed": (
        SEVEN_JOINT_URDF.replace('velocity="2.5"', 'velocity="0"'),
        "URDF {urdf} joint 'a4' <limit> velocity must be above 0, not 0: correct it, or set max_velocity in",
    ),
}


@pytest.mark.parametrize(("urdf", "sentence"), NO_ARM.values(), ids=NO_ARM.keys())
def test_a_description_of_no_arm_is_one_line_with_joint_and_element(urdf, sentence, tmp_path, capsys, monkeypatch):
    async def run(_app):
        raise AssertionError("it is served")

    monkeypatch.setattr(App, "run", run)
    files = {"urdf": (tmp_path / "arm.urdf", urdf), "srdf": (tmp_path / "arm.srdf", SEVEN_JOINT_SRDF)}
    for path, content in files.values():
        path.write_text(content)
    options = [word for name, (path, _) in files.items() for word in (f"--{name}", str(path))]
    assert cli.main(["serve", *options]) == ExitCode.USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"armbridge: {sentence.format(urdf=tmp_path / 'arm.urdf')}")


def test_an_arm_process_that_cannot_be_started_is_one_line_and_exit_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    assert cli.main(["serve", "--port", "0"]) == ExitCode.FAILED
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armbridge: the arm process cannot be started: [Errno 2] No such file")


@pytest.mark.parametrize("command", ["serve", "replay"])
def test_bad_interface_files_are_one_report(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    path = tmp_path / "my_msgs" / "msg" / "Thing.msg"
    path.write_text("int33 a\nint32 b c\n")
    recording = [str(record(tmp_path / "run.mcap", [text(0)]))] if command == "replay" else []
    arguments = [command, *recording, "--port", "0", "--interfaces", str(tmp_path / "my_msgs")]
    assert cli.main(arguments) == ExitCode.USAGE
    assert capsys.readouterr().err.splitlines()[-3:] == [
        "armbridge: server.interfaces: 2 problems in interface files:",
        f"  {path}:1: 'int33 a': type int33 is unknown; did you mean int32?",
        f"  {path}:2: 'int32 b c': wanted int32 (-2147483648 to 2147483647), got c",
    ]


def test_a_file_that_is_no_recording_is_one_line_and_exit_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    assert cli.main(["replay", str(tmp_path / "notes.txt"), "--port", "0"]) == ExitCode.FAILED
    assert capsys.readouterr().err == f"armbridge: recording {tmp_path / 'notes.txt'}: is not an MCAP file\n"


def test_a_replay_has_the_settings_of_a_file_and_needs_a_token(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "armbridge.toml"
    config.write_text("[server]\nport = 0\nhost = '0.0.0.0'\n")
    path = record(tmp_path / "run.mcap", [text(0), text(1)])
    arguments = ["replay", str(path), "--config", str(config), "--rate", "100"]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "ARMBRIDGE_ACCESS__TOKEN" in capsys.readouterr().err
    assert cli.main([*arguments, "--insecure"]) == ExitCode.DONE
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "correct-horse-battery")
    assert cli.main(arguments) == ExitCode.DONE


def test_a_start_that_cannot_be_is_told_in_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["emulate", "--start=0,0"]) == ExitCode.FAILED
    assert "armbridge: the start pose needs 6 positions, not 2" in capsys.readouterr().err
