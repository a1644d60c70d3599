import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from harness.server import ROOT
from harness.waiting import TIMEOUT_S
from server import cli
from server.installation import PAGE_DIRECTORY, version_line
from tests.helpers.programs import run_python


@pytest.mark.parametrize("arguments", [["config"], ["--help"]])
def test_a_reader_that_has_read_enough_gets_no_traceback(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "server.cli", *arguments]
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=TIMEOUT_S)
    finally:
        os.close(writing)
    assert done.stderr == ""


def test_a_pipe_that_breaks_elsewhere_is_an_error_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> int:
        raise BrokenPipeError("a socket")

    monkeypatch.setattr(cli, "main", broken)
    with pytest.raises(BrokenPipeError, match="a socket"):
        cli.run_process()


def exit_code_of(*arguments: str) -> object:
    """The exit code of a command that the parser ends."""
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    return ended.value.code


def test_help_names_every_command_and_unknown_ones_are_usage_errors(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code_of("--help") == 0
    said = capsys.readouterr().out
    for command in ("serve", "scan", "calibrate", "doctor", "relax", "plan", "replay", "emulate", "config"):
        assert command in said
    assert "Exit code 0" in said
    assert exit_code_of("dance") == 2
    assert exit_code_of("serve", "--prot", "9191") == 2
    said = capsys.readouterr().err
    assert said.splitlines()[-1] == "armbridge: error: --prot: unknown; did you mean --port?"


@pytest.mark.parametrize("option", ["--robot", "--calibration"])
def test_a_path_that_cannot_be_looked_at_is_one_line(capsys: pytest.CaptureFixture[str], option: str) -> None:
    assert cli.main(["serve", option, "x" * 300]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("armbridge: ")
    assert line.endswith("x: File name too long")


# Sessions of zenoh whose callbacks never end; the interpreter's own end would abort for nearly every one.
HELD_UP = """
import threading, time, zenoh
from robot import arm, logs
from server import app, cli
from server.errors import StartError

def hold(_sample):
    held.release()
    while True:
        time.sleep(0.0001)

def talk_to_oneself():
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    session = zenoh.open(config)
    subscriber = session.declare_subscriber("a", hold)
    session.put("a", b"")

held = threading.Semaphore(0)
threads = [threading.Thread(target=talk_to_oneself, daemon=True) for _ in range(8)]
for thread in threads:
    thread.start()
for _ in threads:
    held.acquire()
print("said", end="")
cli.main = lambda: 3
cli.run_process()
"""


def test_a_network_that_does_not_end_changes_no_exit_code() -> None:
    answer = run_python(HELD_UP)
    assert (answer.returncode, answer.stdout, answer.stderr) == (3, "said", "")


def test_the_version_is_told_and_heads_the_changelog(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "index.html").write_text('<head>\n<meta name="version" content="0.1.9">\n</head>')
    assert version_line(tmp_path) == f"armbridge {metadata.version('armbridge')}, page 0.1.9"
    (tmp_path / "index.html").write_text("<head></head>")
    assert version_line(tmp_path).endswith(", page of an unknown version")
    assert version_line(tmp_path / "nowhere").endswith(", without the page")
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--version"])
    assert " ".join(capsys.readouterr().out.split()) == version_line(PAGE_DIRECTORY)
    (version,) = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version
