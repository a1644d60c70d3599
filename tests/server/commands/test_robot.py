"""Commands about robots, plans and the server, and what they write to the terminal."""

import json
import os
import pty
import re
import sys
from pathlib import Path

import pytest
from mcap.writer import Writer

from robot.description import robot_folder
from robot.description.robot_folder import built_in_names
from server import cli
from server.app import App
from server.commands.terminal import AnswerMissing, ExitCode, Terminal, chosen, table
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.helpers.stl_arm import write_package
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF
from tests.server.recordings import record, text


def test_plan_answers_by_a_table_and_bad_input_by_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = {"id": "a", "start": [0.0] * 5, "goal": [0.1] * 5}
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    fields = {"format": "so101-plan-bench/1", "name": "n", "joint_names": joints, "joint_problems": [problem]}
    path = tmp_path / "problem.json"
    path.write_text(json.dumps(fields))
    assert cli.main(["plan", str(path), "--seed", "3"]) == 0
    assert "SUCCESS" in capsys.readouterr().out
    for options, words in (
        (["--robot", "/nowhere"], "robot '/nowhere' is no folder"),
        ([], "/nowhere.json: cannot be read"),
    ):
        assert cli.main(["plan", "/nowhere.json", *options]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert words in said


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


def test_an_import_says_what_it_made_and_how_to_serve_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    urdf = write_package(tmp_path).rename(tmp_path / "arm.urdf")
    (tmp_path / "packages").mkdir()
    (tmp_path / "mesh_arm").rename(tmp_path / "packages" / "mesh_arm")
    monkeypatch.chdir(tmp_path)
    arguments = ["robot", "import", str(urdf), "--out", "so101", "--samples", "50", "--no-convex"]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "--package-path" in capsys.readouterr().err
    assert cli.main([*arguments, "--package-path", str(tmp_path / "packages")]) == ExitCode.DONE
    printed = capsys.readouterr()
    # The name alone is the built-in arm's.
    assert "next: armbridge serve --robot ./so101\n" in printed.out
    assert "50 of 50 states" in printed.err
    assert robot_folder.resolve("./so101").model.default_group == "arm"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "packages"))
    assert cli.main([*arguments, "--overwrite"]) == ExitCode.DONE


def test_what_a_command_cannot_do_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["robot", "import", str(tmp_path / "no.urdf")]) == ExitCode.FAILED
    assert capsys.readouterr().err.startswith(f"armbridge: {tmp_path / 'no.urdf'} cannot be read: ")
    (tmp_path / "notes.txt").write_text("no recording")
    assert cli.main(["replay", str(tmp_path / "notes.txt"), "--port", "0"]) == ExitCode.FAILED
    assert capsys.readouterr().err == f"armbridge: recording {tmp_path / 'notes.txt'}: is not an MCAP file\n"
    assert cli.main(["emulate", "--start=0,0"]) == ExitCode.FAILED
    assert "armbridge: the start pose needs 6 positions, not 2" in capsys.readouterr().err


def test_a_file_without_messages_of_ros_2_is_not_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/t", "json", 0), 1, b"{}", 1)
        writer.finish()
    assert cli.main(["replay", str(tmp_path / "run.mcap"), "--port", "0"]) == ExitCode.FAILED
    assert "run.mcap: has no messages of ROS 2" in capsys.readouterr().err
    assert "/t is left out: it is encoded as 'json', not 'cdr'" in caplog.text


def test_a_wrong_setting_is_one_line_and_exit_2(capsys):
    for arguments, words in (
        (["--calibration", "nobodys"], "nobodys"),
        (["--port", "70000"], "server.port"),
        (["--urdf", "a.urdf"], "urdf and srdf must be given together"),
        (["--urdf", "/nowhere.urdf", "--srdf", "/nowhere.srdf"], "/nowhere.urdf cannot be read"),
        (["--config", "/nowhere.toml"], "/nowhere.toml cannot be read"),
    ):
        assert cli.main(["serve", *arguments]) == ExitCode.USAGE
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line


# tests/robot/description has all that is refused.
NO_ARM = {
    "no joint that moves": (
        re.sub(r"<axis[^>]*><limit[^>]*>", "", SEVEN_JOINT_URDF).replace('"revolute"', '"fixed"'),
        "URDF {urdf} has no movable joint: no <joint> has the type revolute, continuous or prismatic",
    ),
    "no range": (
        SEVEN_JOINT_URDF.replace('lower="-1.9" upper="1.9" ', ""),
        "URDF {urdf} joint 'a2' <limit> lower 0 must be below upper 0",
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


def test_a_replay_has_the_settings_of_a_file_and_needs_a_token(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "armbridge.toml"
    config.write_text("[server]\nport = 0\nhost = '0.0.0.0'\n")
    path = record(tmp_path / "run.mcap", [text(0), text(1)])
    arguments = ["replay", str(path), "--config", str(config)]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "ARMBRIDGE_ACCESS__TOKEN" in capsys.readouterr().err
    assert cli.main([*arguments, "--insecure"]) == ExitCode.DONE
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "correct-horse-battery")
    assert cli.main(arguments) == ExitCode.DONE


@pytest.fixture
def typed():
    """A terminal, and a function that types into it."""
    read_end, write_end = os.pipe()
    yield Terminal(read_end), lambda text: os.write(write_end, text.encode())
    for descriptor in (read_end, write_end):
        os.close(descriptor)


def test_only_yes_is_yes_each_question_takes_one_line_and_looking_for_one_does_not_wait(typed, capsys):
    terminal, write = typed
    write("y\nYES\n\nyellow\n\n")
    assert [terminal.confirm("Go on?") for _ in range(4)] == [True, True, False, False]
    assert capsys.readouterr().err == "Go on? [y/N]\n" * 4
    assert terminal.line_typed() == ""
    assert terminal.line_typed() is None
    assert terminal.line_typed() is None
    write("half a line")
    assert terminal.line_typed() is None
    write("\n")
    assert terminal.line_typed() == "half a line"


def test_keys_pressed_before_a_question_do_not_answer_it():
    keyboard, descriptor = pty.openpty()

    class Answered(Terminal):
        """A terminal at which somebody types ``n`` once a question is printed."""

        def err(self, text):
            super().err(text)
            os.write(keyboard, b"n\n")

    terminal = Answered(descriptor)
    os.write(keyboard, b"y\ny\n")
    assert not terminal.confirm("Write this?")
    os.write(keyboard, b"\n\n")
    terminal.ask("Hold the arm. Enter: done.")
    assert terminal.line_typed() == "n"
    for each in (keyboard, descriptor):
        os.close(each)


def test_an_input_that_ends_answers_nothing():
    with Path("/dev/null").open() as empty, pytest.raises(AnswerMissing):
        Terminal(empty.fileno()).await_enter("Hold the arm")


def test_a_live_table_replaces_the_last_one_and_columns_are_as_wide_as_their_widest_entry(capsys, monkeypatch):
    terminal = Terminal()
    terminal.show_live("1\n2")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    terminal.show_live("1\n2")
    terminal.show_live("3\n4")
    assert capsys.readouterr().err == "1\n2\n\x1b[2A\x1b[J3\n4\n"
    assert table(("id", "joint"), [(1, "pan"), (100, "x")]) == "id   joint\n1    pan\n100  x"


def test_enter_is_the_first_answer_but_answers_no_question_about_yes_or_no():
    for typed, answers, answer in (
        ("", ("done", "skip", "skip all"), "done"),
        (" Skip ", ("done", "skip", "skip all"), "skip"),
        ("y", ("yes", "no"), "yes"),
        ("", ("yes", "no"), ""),
        ("s", ("done", "skip", "skip all"), "s"),
    ):
        assert chosen(typed, answers) == answer
