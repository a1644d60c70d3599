"""``armbridge verify`` against a running server."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from harness.server import RunningServer, free_port
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.programs import run

TOKEN = "only-the-admin-knows-it"


def verify(url: str, typed: str, *options: str) -> subprocess.CompletedProcess[str]:
    return run(sys.executable, "-m", "server.cli", "verify", "--url", url, *options, input=typed)


def test_a_person_at_a_terminal_compares_the_arm_pose_by_pose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    with RunningServer("--port 0 --rate 5", {"ARMBRIDGE_ACCESS__TOKEN": TOKEN}) as server:
        without_token = cli.main(["verify", "--url", server.url])
        assert (without_token, capsys.readouterr().err[:11]) == (ExitCode.FAILED, "armbridge: ")
        # Input that ends cancels the procedure.
        assert verify(server.url, "", "--token-file", str(file)).returncode == ExitCode.FAILED
        assert server.has_logged("verify ended early: cancelled")
        # Move; yes at three poses; the gripper does not look as the model.
        answer = verify(server.url, "\ny\ny\ny\nno\ngripper\n", "--token-file", str(file))
    assert answer.returncode == ExitCode.PROBLEMS, answer.stderr
    assert "deg from its goal" in answer.stderr
    droops_deg = [float(each) for each in re.findall(r"^\w+ +(\d+\.\d)$", answer.stderr, re.MULTILINE)]
    assert droops_deg
    assert max(droops_deg) < 3.5
    assert "* gripper looks otherwise than the model" in answer.stdout
    assert "compared in 4 poses" in answer.stdout


def test_a_missing_server_and_a_missing_token_file_are_errors(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert cli.main(["verify", "--url", f"ws://127.0.0.1:{free_port()}"]) == ExitCode.FAILED
    assert "is armbridge serve running there?" in capsys.readouterr().err
    assert cli.main(["verify", "--token-file", str(tmp_path / "none")]) == ExitCode.USAGE
    assert "cannot be read" in capsys.readouterr().err
