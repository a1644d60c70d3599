"""``armbridge verify`` against a running server."""

import subprocess
import sys

import pytest

from harness.server import ServerOnBus, free_port, server_on_bus
from harness.waiting import TIMEOUT_S
from server import cli
from server.commands.terminal import ExitCode

TOKEN = "only-the-admin-knows-it"


def verify(url: str, typed: str, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "server.cli", "verify", "--url", url, *options]
    return subprocess.run(command, input=typed, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


@pytest.fixture(scope="module")
def arm():
    with server_on_bus(ACCESS__TOKEN=TOKEN) as running:
        yield running


def test_a_person_at_a_terminal_compares_the_arm_pose_by_pose(arm: ServerOnBus, tmp_path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    # Move; yes at three poses; the gripper does not look as the model.
    answer = verify(arm.server.url, "\ny\ny\ny\nno\ngripper\n", "--token-file", str(file))
    assert answer.returncode == ExitCode.PROBLEMS, answer.stderr
    assert "deg from its goal" in answer.stderr
    assert "* gripper looks otherwise than the model" in answer.stdout
    assert "compared in 4 poses" in answer.stdout


def test_without_an_admins_token_the_server_refuses(arm: ServerOnBus) -> None:
    answer = verify(arm.server.url, "\n")
    assert answer.returncode == ExitCode.FAILED
    assert answer.stderr.startswith("armbridge: ")


def test_input_that_ends_cancels_the_procedure(arm: ServerOnBus, tmp_path) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    assert verify(arm.server.url, "", "--token-file", str(file)).returncode == ExitCode.FAILED
    assert arm.server.has_logged("verify ended early: cancelled")


def test_a_missing_server_and_a_missing_token_file_are_errors(capsys, tmp_path) -> None:
    assert cli.main(["verify", "--url", f"ws://127.0.0.1:{free_port()}"]) == ExitCode.FAILED
    assert "is armbridge serve running there?" in capsys.readouterr().err
    assert cli.main(["verify", "--token-file", str(tmp_path / "none")]) == ExitCode.USAGE
    assert "cannot be read" in capsys.readouterr().err
