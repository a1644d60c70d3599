"""Every program in examples/ does with the simulated arm what it says, and ends in order without a server."""

import ast
import itertools
import re
import runpy
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack
from typing import Any

import pytest
from websockets.sync.client import connect

from harness.clients import call_on
from harness.server import CLIENT_ENVIRONMENT, FAST_ARMS, RunningServer, free_port
from harness.waiting import running
from server import cli
from tests.examples.conftest import EXAMPLE_TIMEOUT_S, EXAMPLES, RunExample

SCREEN_LINES = 100

# The experiments on servos are no client of a server.
NAMES = sorted(path.name for path in EXAMPLES.glob("*.py") if path.name != "servo_experiments.py")


@pytest.fixture
def silent_port() -> Iterator[tuple[socket.socket, int]]:
    """A port that takes TCP connections and never says a word."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        yield listener, listener.getsockname()[1]


def started(program: str, url: str, **options: Any) -> AbstractContextManager[subprocess.Popen[str]]:
    """An example that goes on."""
    command = [sys.executable, str(EXAMPLES / program), "--url", url]
    return running(command, stdout=subprocess.PIPE, env=CLIENT_ENVIRONMENT, **options)


@pytest.mark.parametrize("name", NAMES)
def test_help_connects_to_nothing(
    name: str,
    silent_port: tuple[socket.socket, int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    listener, port = silent_port
    monkeypatch.setattr(sys, "argv", [name, "--url", f"ws://127.0.0.1:{port}", "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert ended.value.code == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert "--url URL" in printed.out
    assert "(default: ws://127.0.0.1:9090)" in " ".join(printed.out.split())
    with pytest.raises(BlockingIOError):
        listener.accept()


def test_without_a_server_is_one_line() -> None:
    port = free_port()
    with ExitStack() as programs:
        # All at once, as each waits for its connection for seconds.
        url = f"ws://127.0.0.1:{port}"
        waiting = {name: programs.enter_context(started(name, url, stderr=subprocess.PIPE)) for name in NAMES}
        for name, program in waiting.items():
            stdout, stderr = program.communicate(timeout=EXAMPLE_TIMEOUT_S)
            assert stderr.startswith(f"no server answers at {url}: start one with armbridge serve"), name
            assert (stderr.count("\n"), program.returncode, stdout) == (1, 1, ""), name


def test_a_silent_server_is_no_server(run_example: RunExample, silent_port: tuple[socket.socket, int]) -> None:
    _, port = silent_port
    url = f"ws://localhost:{port}"
    done = run_example("named_goal.py", "--url", url)
    assert done.stderr == f"{url}: no answer yet; waiting up to 10 s\n{url}: no answer to the connection within 10 s\n"
    assert done.returncode == 1


@pytest.mark.parametrize("arguments", [("joint_goal.py", "a=b"), ("pose_goal.py", "left")])
def test_a_wrong_argument_is_named_before_connecting(arguments: tuple[str, str], run_example: RunExample) -> None:
    done = run_example(*arguments)
    assert done.returncode == 2
    assert repr(arguments[1]) in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("named_goal.py", "ready"), "the arm is there\n"),
        # A point to the right has a negative coordinate.
        (("pose_goal.py", "0.25", "-0.1", "0.2"), "the arm is there\n"),
        (("square_in_the_air.py",), "a square of 6 cm\n"),
        (
            ("pick_and_place.py",),
            "nothing is lifted: the fingers closed on nothing, as they do without physics\n"
            "the block stands at x 0.16, y -0.11 m, 0 mm above the floor\n",
        ),
    ],
)
def test_an_example_works(words: tuple[str, ...], told: str, run_example: RunExample, server: RunningServer) -> None:
    done = run_example(*words, "--url", server.url)
    assert (done.returncode, done.stdout) == (0, told), done.stderr


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("named_goal.py", "raedy"), "INVALID_GOAL_CONSTRAINTS (-16): "),
        (("leader_follower.py", "--leader", "nobody"), "leader: must be an arm that leads (none) or a topic"),
        (("two_hands.py",), "the server has no arm 'left'; its arms: one, without a name\n"),
        (("fetch_wave.py",), "this arm is no Fetch: start one with armbridge serve --robot fetch\n"),
    ],
)
def test_what_cannot_be_done_is_told_and_ends_with_1(
    words: tuple[str, ...], told: str, run_example: RunExample, server: RunningServer
) -> None:
    done = run_example(*words, "--url", server.url)
    assert done.returncode == 1
    assert told in done.stderr


def test_joints_are_turned_while_their_way_is_told(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("joint_goal.py", "--url", server.url, "shoulder_pan=10")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "executing" in done.stdout
    assert done.stdout.splitlines()[-1] == "done       100%  the arm is there"


def test_a_point_out_of_reach_becomes_the_nearest_one(run_example: RunExample, server: RunningServer) -> None:
    done = run_example("pose_goal.py", "1", "0", "0.2", "--url", server.url)
    assert done.returncode == 0, done.stdout + done.stderr
    refusal, success = done.stdout.splitlines()
    assert "cannot reach" in refusal
    assert success == "the arm is there"


def test_two_arms_are_moved_each_by_its_name_and_then_together(run_example: RunExample) -> None:
    with RunningServer(f"--port 0 --config {EXAMPLES / 'two_arms.toml'}", FAST_ARMS) as arms:
        done = run_example("two_hands.py", "--url", arms.url)
    assert done.returncode == 0, done.stdout + done.stderr
    *each, both = done.stdout.splitlines()
    assert sorted(each) == ["left: the arm is there", "right: the arm is there"]
    assert both == "both: the arm is there"


def test_an_arm_follows_its_leader_until_ctrl_c() -> None:
    with (
        RunningServer(f"--port 0 --config {EXAMPLES / 'leader_follower.toml'}", FAST_ARMS) as arms,
        started("leader_follower.py", arms.url) as following,
    ):
        assert following.stdout is not None
        lines = list(itertools.takewhile(lambda line: not line.startswith("following"), following.stdout))
        following.send_signal(signal.SIGINT)
        rest, _ = following.communicate(timeout=EXAMPLE_TIMEOUT_S)
    assert "idle: " in rest, (lines, rest)
    assert following.returncode == 0


def test_the_wave_goes_on_until_ctrl_c_and_leaves_the_arm_standing(server: RunningServer) -> None:
    with started("classroom_wave.py", server.url) as wave:
        assert wave.stdout is not None
        lines = [wave.stdout.readline() for _ in range(2)]
        wave.send_signal(signal.SIGINT)
        rest, _ = wave.communicate(timeout=EXAMPLE_TIMEOUT_S)
    assert lines == ["there\n", "there\n"]
    assert wave.returncode == 0
    assert rest.splitlines()[-1] == "the arm does not move"


def test_the_wave_tells_why_it_may_not_move_the_arm(server: RunningServer) -> None:
    with connect(server.url) as other, started("classroom_wave.py", server.url) as wave:
        assert call_on(other, "/arm/take_control")["success"]
        assert wave.stdout is not None
        assert "has controlled the arm since" in next(line for line in wave.stdout if line != "there\n")
        wave.send_signal(signal.SIGINT)
        wave.communicate(timeout=EXAMPLE_TIMEOUT_S)


@pytest.mark.parametrize("name", NAMES)
def test_the_header_of_an_example_names_the_command_of_its_server(name: str) -> None:
    header = ast.get_docstring(ast.parse((EXAMPLES / name).read_text())) or ""
    command = re.search(r"``armbridge (serve[^`]*)``", header)
    assert command, f'examples/{name}: end its docstring with "The server: ``armbridge serve ...``."'
    with pytest.raises(SystemExit) as ended:
        cli.main([*shlex.split(command[1]), "--help"])
    assert ended.value.code == 0


def test_every_example_fits_on_a_screen() -> None:
    programs = [*(EXAMPLES / name for name in NAMES), *EXAMPLES.glob("*.html")]
    too_long = [path.name for path in programs if len(path.read_text().splitlines()) > SCREEN_LINES]
    assert programs
    assert not too_long
