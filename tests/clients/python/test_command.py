"""The command ``python -m armbridge_client`` shows, moves, watches and stops the simulated arm."""

import signal
import subprocess
import sys

import pytest

from armbridge_client.__main__ import main
from harness.server import ROOT, RunningServer, free_port
from harness.waiting import TIMEOUT_S


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        (["move", "ready"], 0, "the arm is there\n"),
        (["move", "0.25", "0", "0.12", "--speed", "0.9"], 0, "the arm is there\n"),
        (["move", "elbow_flex=0.5", "wrist_roll=0.1"], 0, "the arm is there\n"),
        (["stop"], 0, "the arm does not move\n"),
        (["move", "redy"], 1, "INVALID_GOAL_CONSTRAINTS (-16): there is no named target 'redy'"),
        (["move", "1", "2"], 1, "target must be a name (ready), a position"),
        (["move", "elbow_flex=far"], 1, "could not convert string to float: 'far'"),
        (["--arm", "left", "state"], 1, "the server has no arm 'left'; its arms: one, without a name"),
    ],
)
def test_a_command_prints_a_sentence_and_ends_with_1_when_it_fails(
    words: list[str], code: int, printed: str, server: RunningServer, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--url", server.url, *words]) == code
    assert capsys.readouterr()[code].startswith(printed)


def test_the_state_is_printed(server: RunningServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--url", server.url, "state"]) == 0
    mode, joints, tip = capsys.readouterr().out.splitlines()
    assert mode == "holding: the arm holds"
    assert "elbow_flex=" in joints
    assert tip.endswith("m in base_link")


def test_without_a_server_a_command_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--url", f"ws://127.0.0.1:{free_port()}", "state"]) == 1
    assert capsys.readouterr().err.startswith("no server answers")


def test_watching_ends_by_ctrl_c(server: RunningServer) -> None:
    command = [sys.executable, "-m", "armbridge_client", "--url", server.url, "watch", "--rate", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT / "clients" / "python") as watching:
        assert watching.stdout is not None
        lines = [watching.stdout.readline() for _ in range(3)]
        watching.send_signal(signal.SIGINT)
        assert watching.wait(TIMEOUT_S) == 130
    assert all(line.startswith("holding shoulder_pan=") for line in lines)
