"""The client's command and its wheel."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from armbridge_client.__main__ import main
from harness.server import ROOT, RunningServer, free_port
from harness.waiting import TIMEOUT_S
from tests.helpers.programs import UV, environment_with, run


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        (["move", "ready"], 0, "the arm is there\n"),
        (["move", "0.25", "0", "0.12", "--speed", "0.9"], 0, "the arm is there\n"),
        (["move", "elbow_flex=0.5", "wrist_roll=0.1"], 0, "the arm is there\n"),
        (["stop"], 0, "the arm does not move\n"),
        (["move", "redy"], 1, "INVALID_GOAL_CONSTRAINTS (-16): there is no named target 'redy'"),
        (["move", "1", "2"], 1, "target must be a name (ready), a position"),
        (["move", "elbow_flex=far"], 1, "target must be a name (ready), a position"),
        (["state", "--arm", "left"], 1, "the server has no arm 'left'; its arms: one, without a name"),
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


def test_tls_at_a_server_without_a_certificate_has_a_remedy(
    server: RunningServer, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--url", server.url.replace("ws:", "wss:"), "state"]) == 1
    assert "; the server has no certificate: use ws://" in capsys.readouterr().err


def test_watching_ends_by_ctrl_c(server: RunningServer) -> None:
    command = [sys.executable, "-m", "armbridge_client", "--url", server.url, "watch", "--rate", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT / "clients" / "python") as watching:
        assert watching.stdout is not None
        lines = [watching.stdout.readline() for _ in range(3)]
        watching.send_signal(signal.SIGINT)
        assert watching.wait(TIMEOUT_S) == 130
    assert all(line.startswith("holding shoulder_pan=") for line in lines)


PYENV = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
MOST_BYTES = 5_000_000

# Without asyncio's log lines about callbacks of over 0.1 s, which a busy machine has.
PROGRAM = """
import logging
import sys
from armbridge_client import GoalRefused, connect
logging.getLogger("asyncio").addFilter(lambda record: "took" not in record.getMessage())
with connect(sys.argv[1]) as arm:
    arm.plan("ready").execute()
    try:
        arm.move_to(0.9, 0.0, 0.1)
    except GoalRefused as refused:
        arm.move(refused.suggestion)
    print(next(arm.states()).mode)
"""


def python(version: str) -> str | None:
    """A Python of a version, from the path or pyenv's."""
    return next(map(str, PYENV.glob(f"{version}.*/bin/python")), shutil.which(f"python{version}"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    # By way of the sdist, which therefore has all that is needed.
    run(UV, "build", "--out-dir", out, ROOT / "clients" / "python", check=True)
    (made,) = out.glob("*.whl")
    return made


@pytest.mark.parametrize("version", ["3.10", "3.13"])
def test_the_wheel_moves_the_arm(version: str, wheel: Path, server: RunningServer, tmp_path: Path) -> None:
    interpreter = python(version)
    if interpreter is None:
        pytest.skip(f"this machine has no Python {version}")
    installed = environment_with(interpreter, tmp_path / "venv", wheel)
    done = run(installed, "-W", "error", "-X", "dev", "-c", PROGRAM, server.url)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout in ("holding\n", "moving\n")
    (packages,) = tmp_path.glob("venv/lib/python*/site-packages")
    size = sum(
        each.stat().st_size for name in ("armbridge_client", "websockets") for each in packages.glob(f"{name}/**/*.*")
    )
    assert size < MOST_BYTES
